// Steps a case, and compares it with a golden file.
//
//   node step.mjs CASE EXPECTED.json [--no-hashes]    what the golden file says; exit code 1 and one line if it differs
//   node step.mjs CASE COUNT [--nodes] [--no-hashes]  COUNT default steps under gravity; time, nodes if told to

import { main } from "./golden.mjs";

process.exitCode = await main(process.argv.slice(2));
