// What the Khronos validator says of the GLB files named, one JSON object a line; the first argument is the folder
// that it was installed into.
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";

const [folder, ...files] = process.argv.slice(2);
const validator = createRequire(`${folder}/`)("gltf-validator");
for (const file of files) {
  const report = await validator.validateBytes(new Uint8Array(await readFile(file)), { format: "glb", maxIssues: 100 });
  console.log(JSON.stringify(report));
}
