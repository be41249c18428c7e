// Packed arrays: base64 of gzip, and where in the bytes which array begins.

const TYPES = { float32: Float32Array, int32: Int32Array, int16: Int16Array, uint8: Uint8Array };

/** The arrays by name. */
export async function unpack({ arrays, bytes }) {
  const buffer = await decompressed(Uint8Array.from(atob(bytes), (letter) => letter.charCodeAt(0)));
  const views = arrays.map(({ name, type, start, length }) => [name, new TYPES[type](buffer, start, length)]);
  return Object.fromEntries(views);
}

async function decompressed(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

/** Undo second differences along the first axis of an array [rows, columns], in place. */
export function integrateTwice(values, columns) {
  for (let pass = 0; pass < 2; pass += 1) {
    for (let place = columns; place < values.length; place += 1) values[place] += values[place - columns];
  }
  return values;
}
