// Files of a case's folder for openCase, in node: only plain files, never a link, never more than is expected.

import { constants } from "node:fs";
import { open } from "node:fs/promises";
import path from "node:path";

import { MAX_MANIFEST_BYTES } from "./manifest.mjs";
import { HeartcaseError } from "./safetensors.mjs";

// readFile(name, what, size) for openCase; `what` names the file in messages.
export function folderReader(folder) {
  return async (name, what = "case.json", size = MAX_MANIFEST_BYTES) => {
    let handle;
    try {
      handle = await open(
        path.join(folder, name),
        constants.O_RDONLY | (constants.O_NOFOLLOW ?? 0) | (constants.O_NONBLOCK ?? 0),
      );
    } catch {
      throw new HeartcaseError(`${what} is missing or no plain file`);
    }
    try {
      const found = await handle.stat();
      if (!found.isFile()) throw new HeartcaseError(`${what} is missing or no plain file`);
      if (found.size > size) throw new HeartcaseError(`${what} is larger than allowed`);
      const bytes = new Uint8Array(found.size);
      let at = 0;
      while (at < bytes.length) {
        const { bytesRead } = await handle.read(bytes, at, bytes.length - at, at);
        if (bytesRead === 0) throw new HeartcaseError(`${what} cannot be read`);
        at += bytesRead;
      }
      return bytes.buffer;
    } finally {
      await handle.close();
    }
  };
}
