// Plots over time with limits, the certificate's worst values, and a cursor at the scene's time.
// Lengths are those of text of 13 pixels; larger pages have larger text.
const SVG = "http://www.w3.org/2000/svg", TEXT = 13, HEIGHT = 76, LEFT = 40, RIGHT = 78, TOP = 18, BOTTOM = 5, AXIS = 14;

class Plots {
  constructor(data, place, seek) {
    Object.assign(this, { data, place, seek, cursors: [] });
    new ResizeObserver(() => this.draw()).observe(place);
    this.draw();
  }

  x(time) { return LEFT + (this.width - LEFT - RIGHT) * time / (this.data.duration || 1); }

  draw() {
    this.scale = parseFloat(getComputedStyle(this.place).fontSize) / TEXT;
    this.width = (this.place.clientWidth || 800) / this.scale;
    // The strip of phases and the slider have the plots' axis of time.
    for (const [name, size] of [["--left", LEFT], ["--right", RIGHT]]) document.documentElement.style.setProperty(name, `${size * this.scale}px`);
    this.place.replaceChildren();
    this.cursors = this.data.plots.map((plot, i) => this.plot(plot, i === this.data.plots.length - 1));
    this.at(this.time ?? 0);
  }

  plot({ label, t, curves, limits, worst, top, sense }, last) {
    const svg = document.createElementNS(SVG, "svg"), y = (value) => HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * Math.min(value, top) / top;
    const height = HEIGHT + (last ? AXIS : 0);
    svg.setAttribute("viewBox", `0 0 ${this.width} ${height}`);
    svg.style.height = `${height * this.scale}px`;
    const node = (kind, attributes, text) => {
      const element = document.createElementNS(SVG, kind);
      for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
      if (text !== undefined) element.textContent = text;
      return svg.appendChild(element);
    };
    const line = (times, values, style) => {
      let path = "", penDown = false;
      values.forEach((value, i) => {
        if (value !== null) path += `${penDown ? "L" : "M"}${this.x(times[i]).toFixed(1)},${y(value).toFixed(1)}`;
        penDown = value !== null;
      });
      node("path", { d: path, class: style });
    };
    const right = this.width - RIGHT, bottom = HEIGHT - BOTTOM;
    node("rect", { x: LEFT, y: TOP, width: Math.max(0, right - LEFT), height: bottom - TOP, class: "axis" });
    for (const value of ticks(top, 3)) node("text", { x: LEFT - 4, y: y(value) + 4, "text-anchor": "end", class: "tick" }, value);
    for (const time of ticks(this.data.duration, Math.max(2, (right - LEFT) / 90))) {
      node("path", { d: `M${this.x(time)},${bottom}v${last ? 4 : -3}`, class: "axis" });
      if (last) node("text", { x: this.x(time), y: bottom + 14, "text-anchor": "middle", class: "tick" }, `${time} s`);
    }
    for (const limit of limits) {
      line(limit.t, limit.values, "limit");
      if (limit.t.length === 2) {
        const from = sense === "min" ? bottom : TOP, at = y(limit.values[0]);
        node("rect", { x: LEFT, y: Math.min(from, at), width: Math.max(0, right - LEFT), height: Math.abs(from - at), class: "forbidden" });
      }
    }
    for (const values of curves) line(t, values, "curve");
    const baselines = [];
    const write = (text, value, style) => {
      let baseline = y(value) + 4;
      for (const other of baselines) if (Math.abs(other - baseline) < 12) baseline = other + (baseline <= other ? -12 : 12);
      baseline = Math.min(HEIGHT - 2, Math.max(TOP + 8, baseline));  // below the heading
      while (baselines.some((other) => Math.abs(other - baseline) < 12) && baseline + 12 < HEIGHT) baseline += 12;
      baselines.push(baseline);
      node("text", { x: right + 6, y: baseline, class: style }, text);
    };
    for (const limit of limits) if (limit.words) write(limit.words, limit.values[limit.values.length - 1], "limit");
    if (worst) {
      const a = this.x(worst.time), b = y(worst.value);
      node("path", { d: `M${a - 4},${b}L${a},${b - 4}L${a + 4},${b}L${a},${b + 4}Z`, class: "worst" });
      write(`worst ${significant(worst.value)}`, worst.value, "");
    }
    const seek = (event) => {
      const x = (event.clientX - svg.getBoundingClientRect().left) / this.scale;
      if (event.buttons) this.seek(Math.min(1, Math.max(0, (x - LEFT) / (right - LEFT))) * this.data.duration);
    };
    for (const kind of ["pointerdown", "pointermove"]) svg.addEventListener(kind, seek);
    const head = node("text", { x: LEFT, y: TOP - 6 }, `${label.replace("\n", " ")}: `), value = head.appendChild(document.createElementNS(SVG, "tspan"));
    value.setAttribute("class", "value");
    const cursor = node("line", { y1: TOP, y2: bottom, class: "now" });
    this.place.append(svg);
    return { cursor, value, t, curves };
  }

  at(time) {
    this.time = time;
    for (const { cursor, value, t, curves } of this.cursors) {
      cursor.setAttribute("x1", this.x(time));
      cursor.setAttribute("x2", this.x(time));
      const values = [...new Set(curves.map((curve) => significant(valueAt(t, curve, time), 3, 1e-3)))];
      value.textContent = values.join(" to ");
    }
  }
}

// About `count` round numbers from 0 to an end.
function ticks(end, count) {
  const rough = end / count, power = 10 ** Math.floor(Math.log10(rough || 1)), step = power * [1, 2, 5, 10].find((k) => k * power >= 0.999 * rough);
  return Array.from({ length: Math.floor(end / step) + 1 }, (_, i) => Number((i * step).toPrecision(6)));
}

// The value of a curve at a time, or null.
function valueAt(t, values, time) {
  const i = Math.max(1, t.findIndex((sample) => sample >= time)), a = values[i - 1], b = values[i];
  return a === null || b === null ? null : a + (b - a) * Math.min(1, Math.max(0, (time - t[i - 1]) / (t[i] - t[i - 1])));
}

function significant(value, digits = 4, least = 1e-9) {
  if (value === null) return "–";
  if (Math.abs(value) > 1e300) return value > 0 ? "∞" : "−∞";
  const text = Math.abs(value) < least ? 0 : Number(value.toPrecision(digits));  // below are rounding errors
  return Math.abs(text) >= 1e-4 || text === 0 ? String(text) : text.toExponential();
}
