// What arrives, and where in time the page is. Samples: u slot, n number, t seconds, s state, c confidence, l latency in ms,
// f frozen, p pose (x y z qx qy qz qw), b the head's box (depth pixels, one past the last), v how far
// regions can be seen that are not wholly seen, by name, w weights in the order of `units`, m landmarks (pixels).

export const WINDOW_S = 30;
// A little more than is drawn, so that the left edge of the curves is whole.
const KEPT_S = WINDOW_S + 2;
const USERS = 4;

export class Stream {
  constructor() {
    this.units = [];
    this.source = null;
    this.users = Array.from({ length: USERS }, () => ({ samples: [], ranges: null }));
    // Of a session: its frames with nobody in them.
    this.empties = [];
    this.counts = { received: 0, refused: 0, note: "" };
    this.first = Infinity;
    this.last = -Infinity;
    this.paused = false;
    this.time = null;
    this.connected = false;
    this.arrived = 0;
    this.onSource = () => {};
    this.onUnits = () => {};
    this.onRegions = () => {};
    this.onSample = () => {};
    this.onGesture = () => {};
    this.onSetUp = () => {};
    this.receivers = {};
  }

  open(path) {
    const events = new EventSource(path);
    const on = (name, take) => events.addEventListener(name, (event) => take(JSON.parse(event.data)));
    events.onopen = () => {
      // A session is told from its start again.
      if (this.source?.session) this.forget();
      this.connected = true;
    };
    events.onerror = () => { this.connected = false; };
    on("source", (source) => { this.source = source; this.onSource(source); });
    on("schema", (units) => { this.units = units; this.onUnits(); });
    on("regions", (regions) => this.onRegions(regions));
    on("ranges", ({ u, r }) => { if (this.users[u]) this.users[u].ranges = r; });
    on("gesture", (gesture) => this.onGesture(gesture));
    on("setup", (facts) => this.onSetUp(facts));
    on("receivers", (receivers) => { this.receivers = receivers; });
    on("count", (counts) => { this.counts = counts; });
    on("message", (sample) => { this.take(sample); this.onSample(sample); });
  }

  forget() {
    for (const user of this.users) user.samples = [];
    this.empties = [];
    [this.first, this.last] = [Infinity, -Infinity];
  }

  take(sample) {
    this.arrived = performance.now();
    // The sender was started anew: its time begins again. Frames of several users may overtake each other a little.
    if (!this.source?.session && sample.t < this.last - 1) {
      this.forget();
      this.time = null;
    }
    this.first = Math.min(this.first, sample.t);
    this.last = Math.max(this.last, sample.t);
    if (sample.u < 0) {
      if (this.source?.session) this.empties.push(sample);
      // Nobody: whoever was there is gone.
      for (const user of this.users) {
        const before = user.samples.at(-1);
        if (before && before.s !== 0) user.samples.push({ ...before, n: sample.n, t: sample.t, s: 0, w: [], p: undefined, b: undefined, m: undefined });
      }
      return;
    }
    const user = this.users[sample.u];
    if (!user) return;
    const before = user.samples.at(-1);
    // A frame that came in two datagrams.
    if (before && before.n === sample.n && before.t === sample.t) user.samples[user.samples.length - 1] = sample;
    else user.samples.push(sample);
    if (!this.source?.session && !this.paused) {
      const oldest = this.last - KEPT_S;
      let gone = 0;
      while (gone < user.samples.length && user.samples[gone].t < oldest) gone += 1;
      // In pieces, so that it costs nothing per frame.
      if (gone > 64) user.samples.splice(0, gone);
      this.first = Math.max(this.first, oldest);
    }
  }

  get empty() { return this.last === -Infinity; }

  // Seconds of the stream that are shown now.
  now() {
    if (this.time === null) return this.source?.session ? this.first : this.last;
    return this.time;
  }

  // Lets `seconds` of the wall pass.
  pass(seconds) {
    if (this.empty) return;
    if (!this.source?.session) {
      if (!this.paused) this.time = null;
      return;
    }
    if (this.time === null) this.time = this.first;
    if (this.paused) return;
    this.time += seconds;
    // From the end back to the start, once all has been read.
    if (this.time > this.last) this.time = this.last - this.first > 0.5 ? this.first : this.last;
  }

  seek(time) {
    this.time = Math.min(Math.max(time, this.first), this.last);
  }

  pause(paused) {
    if (paused && this.time === null && !this.empty) this.time = this.now();
    this.paused = paused;
    if (!paused && !this.source?.session) this.time = null;
  }

  // Index of the last sample of a user that is not after `time`; -1 if there is none.
  index(slot, time) {
    const samples = this.users[slot].samples;
    let [low, high] = [0, samples.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (samples[middle].t <= time + 1e-6) low = middle + 1;
      else high = middle;
    }
    return low - 1;
  }

  // The sample of a user that is shown now; a user of whom nothing was heard for a second is not there.
  at(slot) {
    const now = this.now();
    const sample = this.users[slot].samples[this.index(slot, now)];
    return sample && now - sample.t < 1 && sample.s !== 0 ? sample : null;
  }

  present() {
    return this.users.map((_, slot) => slot).filter((slot) => this.at(slot));
  }

  // Number of the frame that is seen while nobody is present: -1, the newest, if live; undefined if a session has none yet.
  unpeopled() {
    if (!this.source?.session) return -1;
    const now = this.now();
    return this.empties.findLast(({ t }) => t <= now + 1e-6)?.n;
  }

  // Samples of the last 30 s up to now.
  window(slot) {
    const now = this.now();
    const samples = this.users[slot].samples;
    return samples.slice(this.index(slot, now - WINDOW_S) + 1, this.index(slot, now) + 1);
  }

  // Frames per second of a user, over the last two seconds of the stream.
  rate(slot) {
    const now = this.now();
    const frames = this.index(slot, now) - this.index(slot, now - 2);
    return frames / 2;
  }
}
