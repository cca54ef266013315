// Builds the page, for tools/console: `node build.mjs FOLDER SOURCES`. What is in FOLDER afterwards is
// all that a browser gets, each file also compressed, and manifest.json, which says what each is and
// of which sources: SOURCES is their hash.
import { createHash } from "node:crypto";
import { mkdir, readdir, readFile, rm, writeFile } from "node:fs/promises";
import { dirname, join, relative, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { brotliCompressSync, constants, gzipSync } from "node:zlib";
import { build } from "esbuild";

const TYPES = {
  ".css": "text/css; charset=utf-8",
  ".html": "text/html; charset=utf-8",
  ".js": "text/javascript; charset=utf-8",
  ".svg": "image/svg+xml",
  ".txt": "text/plain; charset=utf-8",
  ".webmanifest": "application/manifest+json",
};

const here = dirname(fileURLToPath(import.meta.url));
const [, , target, sources] = process.argv;
if (!target || !sources) {
  console.error("usage: node build.mjs FOLDER SOURCES");
  process.exit(2);
}
const folder = resolve(target);

/** All files below a folder, sorted. */
async function files(below) {
  const found = await readdir(below, { recursive: true, withFileTypes: true });
  return found
    .filter((each) => each.isFile())
    .map((each) => join(each.parentPath, each.name))
    .sort();
}

/** The packages that the bundle has something of, by the files that went into it. */
function packages(inputs) {
  const names = inputs.map((path) => /(?:^|\/)node_modules\/((?:@[^/]+\/)?[^/]+)\//.exec(path)?.[1]);
  return [...new Set(names.filter(Boolean))].sort();
}

/** Of all that the page contains. A package without a file of its own has it in its description. */
async function licenses(names) {
  const all = [];
  for (const name of names) {
    const folder = join(here, "node_modules", name);
    const own = await readFile(join(folder, "LICENSE"), "utf8").catch(async () => {
      const readme = await readFile(join(folder, "README.md"), "utf8");
      const at = readme.indexOf("# LICENSE");
      if (at < 0) throw new Error(`${name}: its license is not found`);
      return readme.slice(at);
    });
    all.push(`${name}\n\n${own.trim()}\n`);
  }
  const apache = await readFile(join(here, "..", "LICENSE"), "utf8");
  return [...all, `Apache License 2.0, of urdf-loader and of Cardan itself\n\n${apache}`].join(
    `\n${"-".repeat(80)}\n\n`,
  );
}

const bundle = await build({
  absWorkingDir: here,
  entryPoints: { console: "src/main.ts", style: "src/style.css" },
  outdir: folder,
  bundle: true,
  minify: true,
  format: "esm",
  // The 3-D scene is loaded once all else is drawn.
  splitting: true,
  target: "es2022",
  // Descriptions here are made of primitives: no loader of meshes is needed.
  alias: Object.fromEntries(
    ["STLLoader", "ColladaLoader"].map((name) => [
      `three/examples/jsm/loaders/${name}.js`,
      "./src/no_meshes.ts",
    ]),
  ),
  legalComments: "external",
  metafile: true,
  write: false,
});

const page = new Map(bundle.outputFiles.map((each) => [relative(folder, each.path), each.contents]));
// Notices in the sources are fewer than the licenses themselves, which licenses.txt has.
for (const name of [...page.keys()].filter((each) => each.endsWith(".LEGAL.txt"))) page.delete(name);
page.set("licenses.txt", Buffer.from(await licenses(packages(Object.keys(bundle.metafile.inputs)))));
for (const path of await files(join(here, "src", "static"))) {
  page.set(relative(join(here, "src", "static"), path), await readFile(path));
}

await rm(folder, { recursive: true, force: true });
await mkdir(folder, { recursive: true });
const manifest = { sources, files: {} };
for (const [name, data] of [...page].sort()) {
  const suffix = name.slice(name.lastIndexOf("."));
  if (!(suffix in TYPES)) throw new Error(`${name}: its type is not in build.mjs`);
  await writeFile(join(folder, name), data);
  await writeFile(join(folder, `${name}.gz`), gzipSync(data, { level: 9 }));
  await writeFile(
    join(folder, `${name}.br`),
    brotliCompressSync(data, { params: { [constants.BROTLI_PARAM_QUALITY]: 11 } }),
  );
  const sha256 = createHash("sha256").update(data).digest("hex");
  manifest.files[name] = { type: TYPES[suffix], sha256 };
}
await writeFile(join(folder, "manifest.json"), `${JSON.stringify(manifest, null, 1)}\n`);
