// Writes moving pictures as GIF 89a (CompuServe 1990): one palette for all frames, by median cut, and of each frame only
// what changed visibly since the one before.

// Palette of at most `count` colours for pixels given as [r, g, b].
function medianCut(pixels, count) {
  const boxes = [pixels];
  const spread = (box) => [0, 1, 2].map((k) => {
    let [low, high] = [255, 0];
    for (const p of box) {
      if (p[k] < low) low = p[k];
      if (p[k] > high) high = p[k];
    }
    return high - low;
  });
  while (boxes.length < count) {
    let [best, at, axis] = [0, -1, 0];
    boxes.forEach((box, k) => {
      const wide = spread(box);
      wide.forEach((w, channel) => {
        const score = w * Math.sqrt(box.length);
        if (box.length > 1 && score > best) [best, at, axis] = [score, k, channel];
      });
    });
    if (at < 0) break;
    const box = boxes[at].sort((a, b) => a[axis] - b[axis]);
    boxes.splice(at, 1, box.slice(0, box.length >> 1), box.slice(box.length >> 1));
  }
  return boxes.map((box) => [0, 1, 2].map((k) => Math.round(box.reduce((sum, p) => sum + p[k], 0) / box.length)));
}

// LZW with variable length codes, as bytes.
function lzw(indices, depth) {
  const [clear, end] = [1 << depth, (1 << depth) + 1];
  const out = [];
  let [bits, filled, width, next] = [0, 0, depth + 1, end + 1];
  let table = new Map();
  const put = (code) => {
    bits |= code << filled;
    filled += width;
    while (filled >= 8) {
      out.push(bits & 255);
      bits >>>= 8;
      filled -= 8;
    }
  };
  put(clear);
  let prefix = indices[0];
  for (let k = 1; k < indices.length; k++) {
    const key = prefix * 256 + indices[k];
    const known = table.get(key);
    if (known !== undefined) {
      prefix = known;
      continue;
    }
    put(prefix);
    if (next === 4096) {
      put(clear);
      table = new Map();
      [width, next] = [depth + 1, end + 1];
    } else {
      if (next === 1 << width) width += 1;
      table.set(key, next++);
    }
    prefix = indices[k];
  }
  put(prefix);
  put(end);
  if (filled > 0) out.push(bits & 255);
  return out;
}

// The file; frames are RGBA of `width` × `height` pixels, each shown for `hundredths` of a second, over and over. What differs by
// less than `near` (0…255 a channel) from what is shown counts as the same.
function gif(frames, width, height, hundredths, near) {
  const sample = [];
  for (const frame of frames) for (let k = 0; k < frame.length; k += 4 * 37) sample.push([frame[k], frame[k + 1], frame[k + 2]]);
  const palette = medianCut(sample, 255);
  const CLEAR = 255;
  const nearest = new Map();
  const index = (r, g, b) => {
    const key = ((r >> 2) << 12) | ((g >> 2) << 6) | (b >> 2);
    let at = nearest.get(key);
    if (at === undefined) {
      let best = Infinity;
      palette.forEach((p, k) => {
        const d = 2 * (p[0] - r) ** 2 + 4 * (p[1] - g) ** 2 + (p[2] - b) ** 2;
        if (d < best) [best, at] = [d, k];
      });
      nearest.set(key, at);
    }
    return at;
  };
  const word = (v) => [v & 255, v >> 8];
  const parts = [Buffer.from("GIF89a"), Buffer.from([...word(width), ...word(height), 0xf7, 0, 0])];
  parts.push(Buffer.from([...palette, ...Array(256 - palette.length).fill([0, 0, 0])].flat()));
  parts.push(Buffer.from([0x21, 0xff, 11, ...Buffer.from("NETSCAPE2.0"), 3, 1, 0, 0, 0]));
  const shown = new Int16Array(3 * width * height).fill(-999);
  for (const frame of frames) {
    const indices = new Uint8Array(width * height).fill(CLEAR);
    for (let k = 0; k < indices.length; k++) {
      const [r, g, b] = [frame[4 * k], frame[4 * k + 1], frame[4 * k + 2]];
      const change = Math.max(Math.abs(r - shown[3 * k]), Math.abs(g - shown[3 * k + 1]), Math.abs(b - shown[3 * k + 2]));
      if (change < near) continue;
      indices[k] = index(r, g, b);
      shown.set([r, g, b], 3 * k);
    }
    parts.push(Buffer.from([0x21, 0xf9, 4, 0x05, ...word(hundredths), CLEAR, 0]));
    parts.push(Buffer.from([0x2c, 0, 0, 0, 0, ...word(width), ...word(height), 0, 8]));
    const data = lzw(indices, 8);
    for (let k = 0; k < data.length; k += 255) {
      const block = data.slice(k, k + 255);
      parts.push(Buffer.from([block.length, ...block]));
    }
    parts.push(Buffer.from([0]));
  }
  parts.push(Buffer.from([0x3b]));
  return Buffer.concat(parts);
}

module.exports = { gif };
