// Constants of WebGPU that TypeScript's own list of the browser's names leaves out.
declare const GPUBufferUsage: Record<"MAP_READ" | "COPY_SRC" | "COPY_DST" | "UNIFORM" | "STORAGE", number>;
declare const GPUShaderStage: Record<"COMPUTE", number>;
declare const GPUMapMode: Record<"READ", number>;
