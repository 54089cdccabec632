// The scene in three dimensions; `show()` draws the current values of `arrays`.

const DARK = window.matchMedia("(prefers-color-scheme: dark)").matches, TRAIL = 5;  // [s]
const GROUND = new THREE.Color(DARK ? "#23282d" : "#f3f4f5"), WHITE = new THREE.Color("#ffffff");
const shade = (colour) => new THREE.Color(colour).lerp(WHITE, DARK ? 0.16 : 0);

// A surface of triangles with flat shading.
function surface(corners) {
  const geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.Float32BufferAttribute(corners, 3));
  geometry.computeVertexNormals();
  return geometry;
}

class Stage {
  constructor(data, arrays, place) {
    Object.assign(this, { data, arrays, place, time: 0, on: {}, highlight: { drones: [], cables: [], vertices: [] } });
    this.renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    place.prepend(this.renderer.domElement);
    this.scene = new THREE.Scene();
    this.scene.background = GROUND;
    this.camera = new THREE.PerspectiveCamera(35, 1, 0.01, 5000);
    this.camera.up.set(0, 0, 1);
    this.controls = new THREE.OrbitControls(this.camera, this.renderer.domElement);
    this.scene.add(new THREE.HemisphereLight("#ffffff", "#b8bcc2", 2.2));
    const sun = new THREE.DirectionalLight("#ffffff", 1.6);
    sun.position.set(-2, -3, 6);
    this.scene.add(sun);
    this.measure();
    this.addGround();
    this.addBounds();
    this.addDrones();
    this.addObjects();
    const { points, cable_colours: colours, mark } = data;
    this.tubes = new CableTubes(this.scene, points, colours.map(shade), mark);
    if (arrays.ghost) this.ghost = new CableTubes(this.scene, points, colours.map(() => "#b4bac0"), mark);
    this.addPaths();
    this.addArrows();
    this.addMarks();
    this.addLabels();
    this.view("front");
    new ResizeObserver(() => this.resize()).observe(place);
    this.resize();
    this.controls.addEventListener("change", () => this.show());
  }

  measure() {
    const p = this.arrays.drones.values, lower = [Infinity, Infinity, Infinity], upper = [-Infinity, -Infinity, -Infinity];
    for (let i = 0; i < p.length; i++) {
      lower[i % 3] = Math.min(lower[i % 3], p[i]);
      upper[i % 3] = Math.max(upper[i % 3], p[i]);
    }
    lower[2] = Math.min(lower[2], this.data.floor);
    this.lower = lower; this.upper = upper;
    this.centre = new THREE.Vector3(...lower).add(new THREE.Vector3(...upper)).multiplyScalar(0.5);
    this.extent = Math.max(0.5, Math.hypot(upper[0] - lower[0], upper[1] - lower[1], upper[2] - lower[2]));
  }

  addGround() {
    const step = 10 ** Math.round(Math.log10(this.extent / 4)), cells = 2 * Math.ceil(1.6 * this.extent / step);
    const grid = new THREE.GridHelper(cells * step, cells, DARK ? "#4a5158" : "#c2c7cc", DARK ? "#353b41" : "#d9dcdf");
    grid.rotation.x = Math.PI / 2;
    grid.position.set(Math.round(this.centre.x / step) * step, Math.round(this.centre.y / step) * step, this.data.floor - 0.002);
    this.scene.add(grid);
  }

  addBounds() {
    this.lines(new Float32Array(this.data.arena), new THREE.LineBasicMaterial({ color: "#9aa1a8" }));
    for (const { colours: [color], corners } of this.data.keep_outs) {
      const solid = surface(corners), look = { color, transparent: true, opacity: 0.25, depthWrite: false, side: THREE.DoubleSide };
      this.scene.add(new THREE.Mesh(solid, new THREE.MeshLambertMaterial(look)));
      this.scene.add(new THREE.LineSegments(new THREE.EdgesGeometry(solid), new THREE.LineBasicMaterial({ color })));
    }
  }

  addDrones() {
    const { names, drone_parts: parts, ellipsoid } = this.data, count = names.length;
    const instanced = (geometry, material) => {
      const mesh = new THREE.InstancedMesh(geometry, material, count);
      mesh.frustumCulled = false;
      this.scene.add(mesh);
      return mesh;
    };
    this.size = 0.8 * ellipsoid[0];  // approximate radius of a drone with rotors
    this.bodies = parts.map(({ colours, corners }) => {
      const mesh = instanced(surface(corners), new THREE.MeshLambertMaterial({ side: THREE.DoubleSide }));
      colours.forEach((colour, i) => mesh.setColorAt(i, shade(colour)));
      return mesh;
    });
    this.shells = instanced(new THREE.SphereGeometry(1, 24, 16).scale(...ellipsoid), new THREE.MeshLambertMaterial({ color: "#2a8c82", transparent: true, opacity: 0.16, depthWrite: false }));
  }

  addObjects() {
    this.objects = this.data.objects.map(({ colours: [color], corners }) => {
      const geometry = surface(corners);
      const solid = new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ color, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 }));
      solid.add(new THREE.LineSegments(new THREE.EdgesGeometry(geometry, 30), new THREE.LineBasicMaterial({ color: "#7c8288" })));
      this.scene.add(solid);
      return solid;
    });
  }

  updateObjects() {
    const p = this.arrays.places.now, q = this.arrays.turns.now;
    this.objects.forEach((solid, i) => {
      solid.position.set(p[3 * i], p[3 * i + 1], p[3 * i + 2]);
      solid.quaternion.set(q[4 * i + 1], q[4 * i + 2], q[4 * i + 3], q[4 * i]).normalize();
    });
  }

  addPaths() {
    const { names, colours, t } = this.data, p = this.arrays.drones, corners = [], shades = [];
    const stride = Math.max(1, Math.ceil(names.length * t.length / 200000)), pale = colours.map((colour) => shade(colour).lerp(GROUND, 0.45));
    this.pathTimes = [];  // segments are in the order of time, so that trails are a range
    for (let i = 0; i < t.length - 1; i += stride) {
      this.pathTimes.push(t[i]);
      for (let d = 0; d < names.length; d++) {
        const a = i * p.columns + 3 * d, z = Math.min(i + stride, t.length - 1) * p.columns + 3 * d, { r, g, b } = pale[d];
        corners.push(...p.values.subarray(a, a + 3), ...p.values.subarray(z, z + 3));
        shades.push(r, g, b, r, g, b);
      }
    }
    this.paths = this.lines(new Float32Array(corners), new THREE.LineBasicMaterial({ vertexColors: true }));
    this.paths.geometry.setAttribute("color", new THREE.Float32BufferAttribute(shades, 3));
  }

  lines(corners, material) {
    const geometry = new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(corners, 3));
    const lines = new THREE.LineSegments(geometry, material);
    lines.frustumCulled = false;
    this.scene.add(lines);
    return lines;
  }

  addArrows() {
    const count = this.data.names.length;
    this.arrows = {};
    for (const [name, colour] of [["forces", "#c8414f"], ["thrusts", "#0b3c5d"]]) {
      const shafts = this.lines(new Float32Array(6 * count), new THREE.LineBasicMaterial({ color: colour }));
      const heads = new THREE.InstancedMesh(new THREE.ConeGeometry(0.014, 0.05, 10).rotateX(Math.PI / 2), new THREE.MeshBasicMaterial({ color: colour }), count);
      heads.frustumCulled = false;
      this.scene.add(heads);
      this.arrows[name] = { shafts, heads };
    }
  }

  addMarks() {
    const most = 64;
    this.marks = new THREE.InstancedMesh(new THREE.SphereGeometry(1, 16, 12), new THREE.MeshBasicMaterial({ color: this.data.mark, transparent: true, opacity: 0.55, depthTest: false }), most);
    this.marks.frustumCulled = false;
    this.marks.renderOrder = 2;
    this.scene.add(this.marks);
  }

  addLabels() {
    const { names, clasps } = this.data, place = document.getElementById("labels");
    const label = (text) => place.appendChild(Object.assign(document.createElement("span"), { textContent: text }));
    this.labels = [...names.map((name, i) => ({ node: label(name), array: "drones", at: 3 * i, drone: i })),
      ...clasps.map(({ name, point }) => ({ node: label(name), array: "cables", at: 3 * point, drone: -1 }))];
  }

  // Highlights the drones, cables and vertices of a check, by their indices.
  mark(highlight) {
    this.highlight = highlight;
    this.tubes.colour(highlight.cables);
    this.show();
  }

  switch(name, on) {
    this.on[name] = on;
    if (name === "follow") {
      this.view(this.direction);
      if (on) this.camera.position.lerp(this.controls.target, 1 - Math.min(1, 4 * this.spread() / this.distance()));
    }
    this.show();
  }

  // The mean place of all drones, and their maximum distance from it (at least 0.2 m).
  middle() {
    const p = this.arrays.drones.now, sum = new THREE.Vector3();
    for (let i = 0; i < p.length; i += 3) sum.add(new THREE.Vector3(p[i], p[i + 1], p[i + 2]));
    return sum.multiplyScalar(3 / p.length);
  }

  spread() {
    const p = this.arrays.drones.now, middle = this.middle();
    let radius = 0.2;
    for (let i = 0; i < p.length; i += 3) radius = Math.max(radius, middle.distanceTo(new THREE.Vector3(p[i], p[i + 1], p[i + 2])));
    return radius;
  }

  // Saves the picture as a file.
  picture(name) {
    this.renderer.domElement.toBlob((blob) => {
      const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
      link.click();
      URL.revokeObjectURL(link.href);
    });
  }

  // Shows the places of drones at all times, from a standard direction.
  view(kind) {
    this.direction = kind;
    const to = { above: [0, -0.001, 1], front: [-0.35, -0.8, 0.5] }[kind] ?? [0, -1, 0.3];
    const back = new THREE.Vector3(...to).normalize(), right = new THREE.Vector3(-back.y, back.x, 0).normalize();
    const up = back.clone().cross(right), slope = Math.tan(this.camera.fov * Math.PI / 360), height = 0.82 * slope, width = 0.9 * slope * this.camera.aspect;
    const p = this.arrays.drones.values, point = new THREE.Vector3(), target = this.centre.clone();
    let distance = 0.5;
    for (let iteration = 0; iteration < 4; iteration++) {
      distance = 0.5;
      for (let i = 0; i < p.length; i += 3) {
        point.set(p[i], p[i + 1], p[i + 2]).sub(target);
        distance = Math.max(distance, point.dot(back) + Math.max(Math.abs(point.dot(right)) / width, Math.abs(point.dot(up)) / height));
      }
      distance += 2 * this.size;
      // The projection is centred, because near places take more space than far ones.
      const ends = [Infinity, -Infinity, Infinity, -Infinity];
      for (let i = 0; i < p.length; i += 3) {
        point.set(p[i], p[i + 1], p[i + 2]).sub(target);
        const depth = distance - point.dot(back), u = point.dot(right) / depth, v = point.dot(up) / depth;
        ends[0] = Math.min(ends[0], u); ends[1] = Math.max(ends[1], u); ends[2] = Math.min(ends[2], v); ends[3] = Math.max(ends[3], v);
      }
      target.addScaledVector(right, distance * (ends[0] + ends[1]) / 2).addScaledVector(up, distance * (ends[2] + ends[3]) / 2);
    }
    target.addScaledVector(up, 0.08 * slope * distance);  // the switches are above
    this.controls.target.copy(target);
    this.camera.position.copy(target).addScaledVector(back, distance);
    this.camera.near = distance / 500; this.camera.far = distance * 50;
    this.camera.updateProjectionMatrix();
    this.controls.update();
    this.fitted = this.camera.position.clone();
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.place;
    if (!width || !height) return;
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (this.camera.position.equals(this.fitted)) this.view(this.direction);
    this.show();
  }

  distance() { return this.camera.position.distanceTo(this.controls.target); }

  // The projection of a point, in pixels from the stage's upper left corner.
  project(array, at) {
    const p = this.arrays[array].now, point = new THREE.Vector3(p[at], p[at + 1], p[at + 2]).project(this.camera);
    return { x: (point.x + 1) / 2 * this.place.clientWidth, y: (1 - point.y) / 2 * this.place.clientHeight, behind: point.z > 1 };
  }

  show() {
    if (!this.labels) return;
    if (this.on.follow) {
      const offset = this.middle().sub(this.controls.target);
      this.controls.target.add(offset);
      this.camera.position.add(offset);
      this.camera.updateMatrixWorld();
    }
    const { names } = this.data, p = this.arrays.drones.now, q = this.arrays.attitudes.now;
    const matrix = new THREE.Matrix4(), turn = new THREE.Quaternion(), place = new THREE.Vector3(), unit = new THREE.Vector3(1, 1, 1), scale = new THREE.Vector3();
    const droneScale = Math.max(1, 0.0035 * this.distance() / this.size);
    const thrusts = this.arrays.thrusts.now, forces = this.arrays.forces.now, tip = new THREE.Vector3(), up = new THREE.Vector3(0, 0, 1), perNewton = 0.2;
    for (let i = 0; i < names.length; i++) {
      const x = q[3 * i], y = q[3 * i + 1], z = q[3 * i + 2];
      place.set(p[3 * i], p[3 * i + 1], p[3 * i + 2]);
      turn.set(x, y, z, Math.sqrt(Math.max(0, 1 - x * x - y * y - z * z)));
      matrix.compose(place, turn, scale.setScalar(droneScale));
      for (const mesh of this.bodies) mesh.setMatrixAt(i, matrix);
      this.shells.setMatrixAt(i, matrix.compose(place, new THREE.Quaternion(), unit));
      for (const [name, arrow] of Object.entries(this.arrows)) {
        if (name === "forces") tip.set(forces[3 * i], forces[3 * i + 1], forces[3 * i + 2]);
        else tip.copy(up).applyQuaternion(turn).multiplyScalar(thrusts[i]);
        const size = tip.length(), along = new THREE.Quaternion().setFromUnitVectors(up, size > 0 ? tip.clone().normalize() : up);
        tip.multiplyScalar(perNewton).add(place);
        arrow.shafts.geometry.attributes.position.setXYZ(2 * i, ...place).setXYZ(2 * i + 1, ...tip);
        arrow.heads.setMatrixAt(i, matrix.compose(tip, along, scale.setScalar(size > 1e-3 ? 1 : 0)));
      }
    }
    for (const mesh of [...this.bodies, this.shells]) mesh.instanceMatrix.needsUpdate = true;
    for (const [name, { shafts, heads }] of Object.entries(this.arrows)) {
      shafts.visible = heads.visible = !!this.on[name];
      shafts.geometry.attributes.position.needsUpdate = heads.instanceMatrix.needsUpdate = true;
    }
    this.shells.visible = !!this.on.ellipsoids;
    const n = 2 * this.data.names.length, indexAt = (time) => { const i = this.pathTimes.findIndex((t) => t >= time); return i < 0 ? this.pathTimes.length : i; };
    const first = this.on.paths ? 0 : indexAt(this.time - TRAIL), last = this.on.paths ? this.pathTimes.length : indexAt(this.time);
    this.paths.visible = !!(this.on.paths || this.on.trails);
    this.paths.geometry.setDrawRange(n * first, n * (last - first));
    this.updateObjects();
    const radius = Math.max(this.data.radius, 0.0011 * this.distance());
    this.tubes.update(this.arrays.cables.now, radius);
    if (this.ghost) {
      this.ghost.mesh.visible = !!this.on.ghost;
      this.ghost.update(this.arrays.ghost.now, radius);
    }
    this.updateMarks();
    this.updateLabels();
    this.renderer.render(this.scene, this.camera);
  }

  updateMarks() {
    const { drones, vertices } = this.highlight, { clasps } = this.data, matrix = new THREE.Matrix4(), c = this.arrays.cables.now, p = this.arrays.drones.now;
    const points = drones.map((i) => [p, 3 * i, 1.5 * this.size]);
    for (const k of vertices) {
      const clasp = clasps.find(({ vertex }) => vertex === k);
      if (clasp) points.push([c, 3 * clasp.point, 0.6 * this.size]);
    }
    this.marks.count = Math.min(points.length, this.marks.instanceMatrix.count);
    points.slice(0, this.marks.count).forEach(([from, at, size], i) => {
      const radius = Math.max(size, 0.008 * this.distance());
      this.marks.setMatrixAt(i, matrix.makeScale(radius, radius, radius).setPosition(from[at], from[at + 1], from[at + 2]));
    });
    this.marks.instanceMatrix.needsUpdate = true;
  }

  // Shows the labels that are switched on or highlighted; of overlapping labels, the first.
  updateLabels() {
    const few = this.labels.length <= 120, placed = [], em = parseFloat(getComputedStyle(this.place).fontSize);
    const isHighlighted = ({ drone }) => this.highlight.drones.includes(drone);
    for (const label of [...this.labels.filter(isHighlighted), ...this.labels.filter((other) => !isHighlighted(other))]) {
      const { node, array, at, drone } = label;
      node.hidden = !(isHighlighted(label) || (this.on.names && few && (drone >= 0 || this.hooked)));
      if (node.hidden) continue;
      const { x, y, behind } = this.project(array, at), width = (0.8 + 0.45 * node.textContent.length) * em;
      node.hidden = behind || placed.some(([u, v, size]) => u < x + width && x < u + size && Math.abs(v - y) < 0.9 * em);
      if (!node.hidden) placed.push([x, y, width]);
      node.style.transform = `translate(${x + 0.6 * em}px, ${y - 1.4 * em}px)`;
    }
  }
}
