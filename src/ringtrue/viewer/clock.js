// One clock moves several views: `new Clock()` given to each as `options.clock`.
export class Clock {
  constructor() {
    Object.assign(this, { phase: 0, pace: 0.7, playing: false, listeners: new Set() }); // pace: cycles of a mode in a second
  }

  // Calls `f(clock)` at each step and change; returns what ends that.
  on(f) {
    this.listeners.add(f);
    return () => this.listeners.delete(f);
  }

  play() {
    if (this.playing) return;
    this.playing = true;
    this.last = undefined;
    const tick = (t) => {
      if (!this.listeners.size) this.playing = false; // its views have ended
      if (!this.playing) return;
      if (this.last !== undefined) this.phase += Math.min(t - this.last, 100) / 1000 * 2 * Math.PI * this.pace;
      this.last = t;
      this.tell();
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
    this.tell();
  }

  pause() {
    this.playing = false;
    this.tell();
  }

  // Stops at a phase in radians.
  set(phase) {
    this.phase = phase;
    this.pause();
  }

  tell() { for (const f of this.listeners) f(this); }
}
