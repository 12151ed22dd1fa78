// The page: its controls, the files that are dropped on it, and the rate at which it draws.
import * as THREE from 'three';
import { Stage } from './stage.js';

const $ = (id) => document.getElementById(id);
const FILMS = { standard: THREE.NoToneMapping, agx: THREE.AgXToneMapping, neutral: THREE.NeutralToneMapping };
const SPIN = 24; // degrees a second
const stage = new Stage($('canvas'));

const count = (number, word) => `${number.toLocaleString('en')} ${word}${number === 1 ? '' : 's'}`;
const say = (text) => { $('message').textContent = text; };

async function open(name, buffer) {
  say('');
  try {
    if (/\.glb$/i.test(name)) await openModel(name, buffer);
    else if (!stage.primitives.length) say('Drop a .glb first, then an environment for it');
    else openEnvironment(name, buffer);
  } catch (error) {
    say(`${name}: ${error.message}`);
  }
}

async function openModel(name, buffer) {
  const { baked, triangles, attributes, pictures, problems } = await stage.loadModel(buffer).catch((error) => {
    throw new Error(`it cannot be read (${error.message})`);
  });
  for (const id of ['environment', 'model']) slide(id, 0);
  $('name').textContent = name;
  const stored = [attributes && `${count(attributes, 'attribute')} each`, pictures && count(pictures, 'picture')].filter(Boolean);
  $('facts').textContent = [count(baked, 'bake'), count(triangles, 'triangle'), ...stored].join(', ');
  say(problems.join('\n'));
  $('residual').disabled = !stage.primitives.some((one) => one.bake?.turns);
  $('bounces').parentElement.hidden = !stage.primitives.some((one) => one.direct);
  $('lights').disabled = !stage.primitives.some((one) => one.bake?.lights);
  $('panel').hidden = false;
  $('drop').classList.remove('shown');
}

function openEnvironment(name, buffer) {
  stage.loadEnvironment(name, buffer);
  slide('environment', 0);
  $('sky').textContent = name;
  $('reset').hidden = false;
}

async function openAll(files) {
  const models = [...files].sort((a, b) => /\.glb$/i.test(b.name) - /\.glb$/i.test(a.name));
  for (const file of models) await open(file.name, await file.arrayBuffer());
}

function slide(id, value) {
  $(id).value = value;
  document.querySelector(`output[for=${id}]`).value = `${Math.round(value)}°`;
  stage.turn({ [id]: Number(value) });
}

for (const id of ['environment', 'model']) $(id).addEventListener('input', () => slide(id, $(id).value));
for (const id of ['albedo', 'bounces', 'residual', 'lights', 'background']) {
  $(id).addEventListener('change', () => stage.set({ [id]: $(id).checked }));
}
for (const radio of document.querySelectorAll('input[name=view]')) {
  radio.addEventListener('change', () => {
    stage.show(radio.value);
    $('legend').hidden = radio.value !== 'error';
  });
}
function film() {
  const stops = Number($('exposure').value), chosen = $('film').value;
  document.querySelector('output[for=exposure]').value = stops ? `${stops > 0 ? '+' : ''}${stops.toFixed(1)}` : '0';
  // Without a film three.js ignores the exposure: then linear does the same
  stage.renderer.toneMapping = chosen === 'standard' && stops ? THREE.LinearToneMapping : FILMS[chosen];
  stage.renderer.toneMappingExposure = 2 ** stops;
}
for (const id of ['exposure', 'film']) $(id).addEventListener('input', film);
$('reset').addEventListener('click', () => {
  stage.resetEnvironment();
  slide('environment', 0);
  $('sky').textContent = "the file's";
  $('reset').hidden = true;
});
for (const id of ['choose', 'open']) $(id).addEventListener('click', () => $('files').click());
$('files').addEventListener('change', () => openAll($('files').files));

addEventListener('dragover', (event) => {
  event.preventDefault();
  $('drop').classList.add('shown', 'over');
});
addEventListener('dragleave', (event) => {
  if (!event.relatedTarget) $('drop').classList.toggle('shown', !stage.primitives.length);
});
addEventListener('drop', (event) => {
  event.preventDefault();
  $('drop').classList.remove('over');
  $('drop').classList.toggle('shown', !stage.primitives.length);
  openAll(event.dataTransfer.files);
});
function resize() {
  stage.resize(innerWidth, innerHeight, Math.min(devicePixelRatio, 2));
}
addEventListener('resize', resize);
resize();

let last = performance.now(), since = last, frames = 0;
function draw(now) {
  if ($('spin').checked) slide('environment', ((Number(stage.turns.environment) + SPIN * (now - last) / 1000 + 540) % 360) - 180);
  last = now;
  stage.render();
  if (++frames && now - since > 500) {
    const milliseconds = (now - since) / frames;
    $('rate').textContent = `${(1000 / milliseconds).toFixed(0)} frames/s · ${milliseconds.toFixed(1)} ms`;
    [since, frames] = [now, 0];
  }
  requestAnimationFrame(draw);
}

const asked = new URLSearchParams(location.search);
window.viewer = { stage, open, THREE };
if (!asked.has('still')) requestAnimationFrame(draw); // a test draws by itself
if (asked.has('model')) {
  const response = await fetch(asked.get('model'));
  if (response.ok) await open(asked.get('model').split('/').pop(), await response.arrayBuffer());
  else say(`${asked.get('model')} is not there`);
}
window.viewer.ready = true;
