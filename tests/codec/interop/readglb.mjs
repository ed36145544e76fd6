// What the PlayCanvas engine finds in a .glb: one line of JSON with the names of the columns, then each
// column as float32. node readglb.mjs IN OUT
import fs from "node:fs";
import * as pc from "playcanvas";

const [source, target] = process.argv.slice(2);
// The engine asks a page for these, though nothing is drawn. After the import, which looks where it runs.
const listening = { addEventListener() {}, removeEventListener() {} };
const canvas = {
  ...listening,
  width: 4,
  height: 4,
  style: {},
  getBoundingClientRect: () => ({ width: 4, height: 4 }),
};
globalThis.window = { ...listening, location: { href: "file:///" }, devicePixelRatio: 1 };
globalThis.document = { ...listening, createElement: () => canvas, body: { appendChild() {} } };

const options = new pc.AppOptions();
options.graphicsDevice = new pc.NullGraphicsDevice(canvas);
options.componentSystems = [pc.GSplatComponentSystem];
options.resourceHandlers = [pc.ContainerHandler];
const app = new pc.AppBase(canvas);
app.init(options);

const bytes = fs.readFileSync(source);
const contents = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);
const asset = new pc.Asset("model", "container", { url: "a.glb", filename: "a.glb", contents });
asset.on("error", (error) => {
  console.error(error);
  process.exit(1);
});
asset.on("load", () => {
  const { properties } = asset.resource.gsplats[0].resource.gsplatData.elements[0];
  const names = JSON.stringify(properties.map((property) => property.name)) + "\n";
  const columns = properties.map(({ storage }) => Buffer.from(new Float32Array(storage).buffer));
  fs.writeFileSync(target, Buffer.concat([Buffer.from(names), ...columns]));
  process.exit(0);
});
app.assets.add(asset);
app.assets.load(asset);
