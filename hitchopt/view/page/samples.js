"use strict";
// Decodes the samples: deflated second differences over time, with 16 bits in two planes of bytes.
async function decode(data, text) {
  const packed = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  const times = data.t.length, arrays = {};
  let at = 0;
  for (const { name, columns, lower, step } of data.arrays) {
    const count = columns * times, low = at, high = at + count, values = new Float32Array(count);
    at += 2 * count;
    for (let c = 0; c < columns; c++) {
      const axis = c % lower.length;
      let slope = 0, value = 0;
      for (let i = 0; i < times; i++) {
        slope = (slope + bytes[low + c * times + i] + 256 * bytes[high + c * times + i]) & 65535;
        value = (value + slope) & 65535;
        values[i * columns + c] = lower[axis] + step[axis] * value;
      }
    }
    arrays[name] = { columns, values, now: new Float32Array(columns) };
  }
  return arrays;
}

// Interpolates all arrays at a time [s] and stores the values in `now`.
function interpolate(data, arrays, time) {
  const t = data.t;
  let low = 0, high = t.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (t[middle] <= time) low = middle; else high = middle;
  }
  const share = Math.min(1, Math.max(0, (time - t[low]) / (t[high] - t[low])));
  for (const { columns, values, now } of Object.values(arrays)) {
    const a = low * columns, b = high * columns;
    for (let c = 0; c < columns; c++) now[c] = values[a + c] + share * (values[b + c] - values[a + c]);
  }
}
