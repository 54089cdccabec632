// The page: title, tables, playback. Nothing is ever written as HTML, only as text.
const byId = (id) => document.getElementById(id);
// A name such as team.q-leg 0, in which a line breaks after the team's name alone.
const whole = (name) => name.replaceAll("-", "-\u2060").replaceAll(" ", "\u00a0").replace(".", ".\u200b");

function element(kind, text = "", name = "") {
  return Object.assign(document.createElement(kind), { textContent: text, className: name });
}

function row(table, cells, click) {
  const made = element("tr");
  for (const [text, name] of cells) made.append(element("td", text, name));
  if (click) {
    made.tabIndex = 0;
    made.addEventListener("click", click);
    made.addEventListener("keydown", (event) => { if (event.key === "Enter") click(); });
  }
  return table.appendChild(made);
}

class Page {
  constructor(data, arrays) {
    Object.assign(this, { data, arrays, time: 0, playing: false, speed: 1, check: -1 });
    byId("title").textContent = data.title;
    byId("facts").textContent = data.facts;
    byId("verdict").textContent = data.verdict;
    byId("verdict").classList.toggle("bad", !data.certified);
    this.stage = new Stage(data, arrays, byId("stage"));
    this.plots = new Plots(data, byId("plots"), (time) => this.seek(time));
    this.addSwitches();
    this.addPhases();
    this.addChecks();
    this.addControls();
    byId("problem").querySelector("pre").textContent = data.problem;
    byId("problem").hidden = !data.problem;
    for (const [name, value] of data.origin) row(byId("origin").querySelector("table"), [[name], [value]]);
    const wanted = new URLSearchParams(location.hash.slice(1));
    if (wanted.has("view")) this.stage.view(wanted.get("view"));
    this.seek(Number(wanted.get("t")) || 0);
    if (wanted.has("check")) this.showCheck(data.checks.findIndex(({ name }) => name === wanted.get("check")));
  }

  addSwitches() {
    const few = this.data.names.length <= 24;
    for (const [name, on] of [["trails", few], ["paths", false], ["ellipsoids", false], ["forces", false], ["thrusts", false], ["names", few], ["follow", false], ...(this.arrays.ghost ? [["ghost", true]] : [])]) {
      const label = element("label"), box = Object.assign(element("input"), { type: "checkbox", checked: on });
      box.dataset.name = name;
      box.addEventListener("change", () => this.stage.switch(name, box.checked));
      label.append(box, ` ${name === "ellipsoids" ? "downwash ellipsoids" : name}`);
      byId("switches").append(label);
      this.stage.on[name] = on;
    }
  }

  addPhases() {
    const table = byId("phases"), body = element("tbody"), strip = byId("strip");
    this.strips = [];
    this.phases = this.data.phases.map((phase, i) => {
      const go = () => this.seek(phase.start);
      const made = row(body, [[phase.name], [phase.state], [`${phase.start.toFixed(2)} – ${phase.end.toFixed(2)} s`, "n"]], go);
      if (phase.remark) made.cells[0].append(element("div", phase.remark, "remark"));
      const block = Object.assign(element("button", phase.name), { title: `${phase.name}: ${phase.start.toFixed(2)} – ${phase.end.toFixed(2)} s` });
      block.style.left = `${100 * phase.start / this.data.duration}%`;
      block.style.width = `${100 * (phase.end - phase.start) / this.data.duration}%`;
      block.dataset.phase = i;
      block.addEventListener("click", go);
      strip.append(block);
      this.strips.push(block);
      return made;
    });
    table.append(body);
    this.needle = strip.appendChild(element("i"));
  }

  addChecks() {
    const table = byId("checks"), body = element("tbody"), head = element("thead");
    const titles = element("tr");
    for (const [text, name] of [["check"], ["worst", "n"], ["limit", "n"], ["where"], [""]]) titles.append(element("th", text, name));
    head.append(titles);
    this.checks = this.data.checks.map((check, i) => {
      const unit = ["1", ""].includes(check.unit) ? "" : ` ${check.unit}`, sign = check.sense === "min" ? "≥" : "≤";
      const limit = check.limit === null ? "–" : `${sign} ${significant(check.limit)}`, where = check.where.slice(0, 3).map(whole).join(", ") + (check.where.length > 3 ? " …" : "");
      const made = row(body, [[check.name], [significant(check.worst) + unit, "n"], [limit, "n"], [where], [check.holds ? "✓" : "NO", check.holds ? "yes" : "no"]], () => this.showCheck(i));
      made.dataset.check = check.name;
      return made;
    });
    table.append(head, body);
  }

  showCheck(i) {
    const check = this.data.checks[i];
    if (!check) return;
    const again = this.check === i;
    this.check = again ? -1 : i;
    this.checks.forEach((made, k) => made.classList.toggle("shown", k === this.check));
    this.stage.mark(again ? { drones: [], cables: [], vertices: [] } : check.concerned);
    byId("concerned").textContent = again ? "" : `${check.name}${check.where.length ? `: ${check.where.join(", ")}` : ""} at ${check.time.toFixed(2)} s`;
    if (!again) this.seek(check.time);
  }

  addControls() {
    const play = byId("play"), scrub = byId("scrub"), speed = byId("speed");
    play.addEventListener("click", () => this.play(!this.playing));
    scrub.addEventListener("change", () => scrub.blur());
    scrub.max = this.data.duration;
    scrub.addEventListener("input", () => this.seek(Number(scrub.value)));
    for (const factor of [0.1, 0.25, 0.5, 1, 2, 4]) {
      speed.append(Object.assign(element("option", `× ${factor}`), { value: factor, selected: factor === 1 }));
    }
    speed.addEventListener("change", () => { this.speed = Number(speed.value); });
    for (const button of document.querySelectorAll("[data-view]")) {
      button.addEventListener("click", () => { this.stage.view(button.dataset.view); this.stage.show(); });
    }
    byId("png").addEventListener("click", () => this.stage.picture(`${this.data.title} ${this.time.toFixed(2)} s.png`));
    // What is clicked with a mouse does not keep the keys: Space plays.
    document.addEventListener("click", (event) => { if (event.detail) document.activeElement.blur(); });
    document.addEventListener("keydown", (event) => {
      if (event.target.matches("input, select, button, summary")) return;
      const steps = { ArrowLeft: -0.1, ArrowRight: 0.1 };
      if (event.key === " ") { event.preventDefault(); this.play(!this.playing); }
      if (event.key in steps) this.seek(this.time + steps[event.key]);
    });
  }

  play(on) {
    this.playing = on;
    byId("play").textContent = on ? "❚❚" : "▶";
    if (!on) return;
    if (this.time >= this.data.duration) this.seek(0);
    let before = performance.now();
    const tick = (now) => {
      if (!this.playing) return;
      this.seek(this.time + this.speed * (now - before) / 1000);
      before = now;
      if (this.time >= this.data.duration) this.play(false); else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  seek(time) {
    const { duration, phases } = this.data;
    this.time = Math.min(duration, Math.max(0, time));
    this.stage.time = this.time;
    interpolate(this.data, this.arrays, this.time);
    let now = phases.findIndex(({ end }) => this.time < end);
    if (now < 0) now = phases.length - 1;
    this.phase = now;
    this.stage.hooked = !!phases[now]?.hooked;
    this.phases.forEach((made, i) => made.classList.toggle("now", i === now));
    this.strips.forEach((block, i) => block.classList.toggle("now", i === now));
    byId("scrub").value = this.time;
    byId("clock").textContent = `${this.time.toFixed(2)} / ${duration.toFixed(2)} s · ${phases[now]?.name ?? ""}`;
    this.needle.style.left = `${100 * this.time / (duration || 1)}%`;
    this.plots.at(this.time);
    this.stage.show();
  }
}

(async () => {
  for (const each of document.querySelectorAll("details.wide")) each.open = window.innerWidth > 600;
  const data = JSON.parse(byId("data").textContent);
  const arrays = await decoded(data, byId("samples").textContent);
  window.hitchopt = new Page(data, arrays);
})();
