// node browser.mjs: the viewer in a real browser. Reads a JSON line { page, files } for each task:
// `page` is the body of an async function of (viewer, files), run in the page, files being
// ArrayBuffers by the names of `files` (name: path). Prints a JSON line { value } or { error }.
import { existsSync } from 'node:fs';
import { readFile } from 'node:fs/promises';
import { createInterface } from 'node:readline';
import { chromium } from 'playwright-core';
import { serve } from '../../viewer/serve.mjs';

const PROGRAMS = ['/usr/bin/chromium', '/usr/bin/chromium-browser', '/usr/bin/google-chrome'];
const executablePath = process.env.CHROMIUM ?? PROGRAMS.find(existsSync);
if (!executablePath) throw new Error('The viewer is tested in Chromium: make test says how to install it');
const files = new Map();
const server = await serve(0);
const browser = await chromium.launch({
  executablePath, args: ['--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader'],
});
const page = await browser.newPage({ viewport: { width: 240, height: 180 } });
page.on('pageerror', (error) => console.error(String(error)));
page.on('console', (message) => message.type() === 'error' && console.error(message.text()));
await page.exposeFunction('fileOf', async (name) => (await readFile(files.get(name))).toString('base64'));
await page.goto(`http://localhost:${server.address().port}/?still`);
await page.waitForFunction('window.viewer?.ready');
console.log(JSON.stringify({ value: 'ready' }));

for await (const line of createInterface({ input: process.stdin })) {
  const task = JSON.parse(line);
  for (const [name, path] of Object.entries(task.files)) files.set(name, path);
  try {
    const value = await page.evaluate(async ({ body, names }) => {
      const loaded = {};
      for (const name of names) loaded[name] = await (await fetch(`data:;base64,${await fileOf(name)}`)).arrayBuffer();
      const run = new (async () => {}).constructor('viewer', 'files', body);
      return await run(window.viewer, loaded);
    }, { body: task.page, names: Object.keys(task.files) });
    console.log(JSON.stringify({ value }));
  } catch (error) {
    console.log(JSON.stringify({ error: String(error) }));
  }
}
await browser.close();
server.close();
