// Writes a .ksplat of a PLY, by the library that the format comes from:
// node makeksplat.mjs IN.ply OUT.ksplat DEGREE LEVEL SECTION_SIZE
import { readFileSync, writeFileSync } from "node:fs";
import { PlyParser, SplatBufferGenerator } from "@mkkellogg/gaussian-splats-3d";

const [input, output, ...numbers] = process.argv.slice(2);
const [degree, level, sectionSize] = numbers.map(Number);
const bytes = readFileSync(input);
const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);
const splats = PlyParser.parseToUncompressedSplatArray(buffer, degree);
const generator = SplatBufferGenerator.getStandardGenerator(0, level, sectionSize);
writeFileSync(output, Buffer.from(generator.generateFromUncompressedSplatArray(splats).bufferData));
