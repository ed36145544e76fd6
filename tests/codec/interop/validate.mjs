// What the glTF validator of Khronos says of a file, as JSON. node validate.mjs IN
import fs from "node:fs";
import validator from "gltf-validator";

const report = await validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[2])));
console.log(JSON.stringify(report.issues.messages));
