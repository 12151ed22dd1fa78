// npm start [-- SCENE.glb]: the viewer on this machine alone. Prints its address.
import { createReadStream, existsSync } from 'node:fs';
import { createServer } from 'node:http';
import { basename, dirname, extname, join, normalize, resolve, sep } from 'node:path';
import { fileURLToPath } from 'node:url';

const HERE = dirname(fileURLToPath(import.meta.url));
const TYPES = { '.html': 'text/html', '.js': 'text/javascript', '.css': 'text/css', '.glb': 'model/gltf-binary' };

export function serve(port, model) {
  const server = createServer((request, response) => {
    const path = normalize(decodeURIComponent(new URL(request.url, 'http://localhost').pathname));
    const file = model && path === `/file/${basename(model)}` ? model : join(HERE, path === '/' ? 'index.html' : path);
    const allowed = file === model || file.startsWith(HERE + sep);
    if (!allowed || !existsSync(file)) return response.writeHead(404).end();
    response.writeHead(200, { 'Content-Type': TYPES[extname(file)] ?? 'application/octet-stream', 'Cache-Control': 'no-cache' });
    return createReadStream(file).on('error', () => response.destroy()).pipe(response);
  });
  return new Promise((done) => {
    server.once('error', () => server.listen(0, '127.0.0.1')); // the port is taken: any other
    server.listen(port, '127.0.0.1').on('listening', () => done(server));
  });
}

if (process.argv[1] === fileURLToPath(import.meta.url)) {
  const model = process.argv[2] && resolve(process.env.INIT_CWD ?? '.', process.argv[2]);
  if (model && !existsSync(model)) {
    console.error(`${model} is not there`);
    process.exit(2);
  }
  const server = await serve(Number(process.env.PORT ?? 8080), model);
  console.log(`http://localhost:${server.address().port}/${model ? `?model=file/${encodeURIComponent(basename(model))}` : ''}`);
}
