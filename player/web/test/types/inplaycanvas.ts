import { Application, Entity } from "playcanvas";
import { RECIPE, SwingsEntity } from "swings-player/playcanvas";

const app = new Application(document.createElement("canvas"));
Object.assign(app.scene.gsplat, RECIPE);
const entity = new SwingsEntity(app, { url: "stream", loop: false });
entity.currentTime = 1;
export const camera: Promise<Entity> = entity.defaultCamera();
// @ts-expect-error: it has no stream
export const empty = new SwingsEntity(app, { loop: false });
