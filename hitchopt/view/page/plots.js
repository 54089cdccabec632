// Plots over time with limits, the certificate's worst values, and a cursor in step with the scene.
const SVG = "http://www.w3.org/2000/svg", HEIGHT = 74, LEFT = 92, RIGHT = 86, TOP = 6, BOTTOM = 6;

class Plots {
  constructor(data, place, seek) {
    Object.assign(this, { data, place, seek, cursors: [] });
    new ResizeObserver(() => this.draw()).observe(place);
    this.draw();
  }

  x(time) { return LEFT + (this.width - LEFT - RIGHT) * time / (this.data.duration || 1); }

  draw() {
    this.width = this.place.clientWidth || 800;
    this.place.replaceChildren();
    this.cursors = this.data.plots.map((plot) => this.plot(plot));
    this.at(this.time ?? 0);
  }

  plot({ label, t, curves, limits, worst, top, sense }) {
    const svg = document.createElementNS(SVG, "svg"), y = (value) => HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * Math.min(value, top) / top;
    const node = (kind, attributes, text) => {
      const made = document.createElementNS(SVG, kind);
      for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
      if (text !== undefined) made.textContent = text;
      return svg.appendChild(made);
    };
    const line = (times, values, name) => {
      let path = "", pen = false;
      values.forEach((value, i) => {
        if (value === null) { pen = false; return; }
        path += `${pen ? "L" : "M"}${this.x(times[i]).toFixed(1)},${y(value).toFixed(1)}`;
        pen = true;
      });
      node("path", { d: path, class: name });
    };
    const right = this.width - RIGHT;
    node("rect", { x: LEFT, y: TOP, width: Math.max(0, right - LEFT), height: HEIGHT - TOP - BOTTOM, class: "axis" });
    for (const limit of limits) {
      line(limit.t, limit.values, "limit");
      if (limit.t.length === 2) {
        const from = sense === "min" ? HEIGHT - BOTTOM : TOP, at = y(limit.values[0]);
        node("rect", { x: LEFT, y: Math.min(from, at), width: Math.max(0, right - LEFT), height: Math.abs(from - at), class: "forbidden" });
      }
    }
    for (const values of curves) line(t, values, "curve");
    label.split("\n").forEach((text, i) => node("text", { x: LEFT - 6, y: 26 + 14 * i, "text-anchor": "end" }, text));
    const written = [];
    const write = (text, value, name) => {
      let at = y(value) + 4;
      for (const other of written) if (Math.abs(other - at) < 12) at = other + (at <= other ? -12 : 12);
      at = Math.min(HEIGHT - 2, Math.max(10, at));
      written.push(at);
      node("text", { x: right + 6, y: at, class: name }, text);
    };
    for (const limit of limits) if (limit.words) write(limit.words, limit.values[limit.values.length - 1], "limit");
    if (worst) {
      const a = this.x(worst.time), b = y(worst.value);
      node("path", { d: `M${a - 4},${b}L${a},${b - 4}L${a + 4},${b}L${a},${b + 4}Z`, class: "worst" });
      write(`worst ${significant(worst.value)}`, worst.value, "");
    }
    svg.addEventListener("pointerdown", (event) => {
      const x = event.clientX - svg.getBoundingClientRect().left;
      this.seek(Math.min(1, Math.max(0, (x - LEFT) / (right - LEFT))) * this.data.duration);
    });
    const cursor = node("line", { y1: TOP, y2: HEIGHT - BOTTOM, class: "now" });
    this.place.append(svg);
    return cursor;
  }

  at(time) {
    this.time = time;
    for (const cursor of this.cursors) {
      cursor.setAttribute("x1", this.x(time));
      cursor.setAttribute("x2", this.x(time));
    }
  }
}

function significant(value, digits = 4) {
  if (value === null) return "–";
  if (Math.abs(value) > 1e300) return value > 0 ? "∞" : "−∞";
  const text = Number(value.toPrecision(digits));
  return Math.abs(text) >= 1e-4 || text === 0 ? String(text) : text.toExponential();
}
