// The page: title, tables, playback. All content is inserted as text, not as HTML.
const byId = (id) => document.getElementById(id);
// Lets lines break in names such as team.q-leg 0 after the team's name only.
const unbroken = (name) => name.replaceAll("-", "-\u2060").replaceAll(" ", "\u00a0").replace(".", ".\u200b");

function element(kind, text = "", style = "") {
  return Object.assign(document.createElement(kind), { textContent: text, className: style });
}

function addRow(table, cells, onClick) {
  const row = element("tr");
  for (const [text, style] of cells) row.append(element("td", text, style));
  if (onClick) {
    row.tabIndex = 0;
    row.addEventListener("click", onClick);
    row.addEventListener("keydown", (event) => { if (event.key === "Enter") onClick(); });
  }
  return table.appendChild(row);
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
    for (const [name, value] of data.origin) addRow(byId("origin").querySelector("table"), [[name], [value]]);
    const request = new URLSearchParams(location.hash.slice(1));
    if (request.has("view")) this.stage.view(request.get("view"));
    this.seek(Number(request.get("t") ?? data.opens) || 0);
    if (request.has("check")) this.showCheck(data.checks.findIndex(({ name }) => name === request.get("check")));
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
      const seek = () => this.seek(phase.start);
      const row = addRow(body, [[phase.name], [`${phase.start.toFixed(2)} – ${phase.end.toFixed(2)} s`, "n"]], seek);
      if (phase.remark) row.cells[0].append(element("div", phase.remark, "remark"));
      const block = Object.assign(element("button", phase.name), { title: `${phase.name}: ${phase.start.toFixed(2)} – ${phase.end.toFixed(2)} s` });
      block.style.left = `${100 * phase.start / this.data.duration}%`;
      block.style.width = `${100 * (phase.end - phase.start) / this.data.duration}%`;
      block.dataset.phase = i;
      block.addEventListener("click", seek);
      strip.append(block);
      this.strips.push(block);
      return row;
    });
    table.append(body);
    this.needle = strip.appendChild(element("i"));
    new ResizeObserver(() => this.nameStrips()).observe(strip);
  }

  // Names the blocks that are wide enough for the whole name of their phase.
  nameStrips() {
    this.strips.forEach((block, i) => { block.textContent = this.data.phases[i].name; });
    const fit = this.strips.map((block) => block.scrollWidth <= block.clientWidth);
    this.strips.forEach((block, i) => { if (!fit[i]) block.textContent = ""; });
  }

  addChecks() {
    const table = byId("checks"), body = element("tbody"), head = element("thead");
    const titles = element("tr");
    for (const [text, style] of [["check"], ["worst", "n"], ["limit", "n"], ["where"], [""]]) titles.append(element("th", text, style));
    head.append(titles);
    this.checks = [];
    const add = (i, title) => {
      const check = this.data.checks[i];
      const unit = ["1", "", "ratio", "number"].includes(check.unit) ? "" : ` ${check.unit}`, sign = check.sense === "min" ? "≥" : "≤";
      const limit = check.limit === null ? "–" : `${sign} ${significant(check.limit)}`, where = check.where.slice(0, 3).map(unbroken).join(", ") + (check.where.length > 3 ? " …" : "");
      const row = addRow(body, [[title], [significant(check.worst) + unit, "n"], [limit, "n"], [where, check.where.some((name) => name.length > 12) ? "long" : ""], [check.holds ? "✓" : "NO", check.holds ? "yes" : "no"]], () => this.showCheck(i));
      row.dataset.check = check.name;
      if (check.limit > 0) {
        row.cells[1].classList.add("used");
        row.cells[1].style.setProperty("--share", `${100 * Math.min(1, check.sense === "min" ? check.limit / check.worst : check.worst / check.limit)}%`);
      }
      this.checks[i] = row;
    };
    for (const [heading, names] of Object.entries(this.data.groups)) {
      const row = body.appendChild(element("tr", "", "group"));
      row.append(Object.assign(element("td", heading), { colSpan: 5 }));
      for (const [name, title] of names) add(this.data.checks.findIndex((check) => check.name === name), title);
    }
    table.append(head, body);
  }

  showCheck(i) {
    const check = this.data.checks[i];
    if (!check) return;
    const hides = this.check === i;  // a second click
    this.check = hides ? -1 : i;
    this.checks.forEach((row, k) => row.classList.toggle("shown", k === this.check));
    this.stage.mark(hides ? { drones: [], cables: [], vertices: [] } : check.concerned);
    byId("concerned").textContent = hides ? "" : `${check.name}${check.where.length ? `: ${check.where.join(", ")}` : ""} at ${check.time.toFixed(2)} s`;
    if (!hides) this.seek(check.time);
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
    // Elements lose the focus after a mouse click, so that Space plays.
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
    this.phases.forEach((row, i) => row.classList.toggle("now", i === now));
    this.strips.forEach((block, i) => block.classList.toggle("now", i === now));
    byId("scrub").value = this.time;
    byId("clock").textContent = `${this.time.toFixed(2)} / ${duration.toFixed(2)} s · ${phases[now]?.name ?? ""}`;
    this.needle.style.left = `${100 * this.time / (duration || 1)}%`;
    this.plots.at(this.time);
    this.stage.show();
  }
}

(async () => {
  for (const details of document.querySelectorAll("details.wide")) details.open = window.innerWidth > 600;
  const data = JSON.parse(byId("data").textContent);
  const arrays = await decode(data, byId("samples").textContent);
  window.hitchopt = new Page(data, arrays);
})();
