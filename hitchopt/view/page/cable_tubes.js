// Cables as six-sided tubes around curves of `points` points, with one colour per cable.
const SIDES = 6;

class CableTubes {
  constructor(scene, points, colours, mark) {
    Object.assign(this, { points, colours, mark });
    const cables = colours.length, geometry = new THREE.BufferGeometry(), rings = cables * points;
    for (const [name, size] of [["position", 3], ["normal", 3], ["color", 3]]) {
      geometry.setAttribute(name, new THREE.BufferAttribute(new Float32Array(rings * SIDES * size), size).setUsage(THREE.DynamicDrawUsage));
    }
    const index = [];
    for (let c = 0; c < cables; c++) for (let i = 0; i + 1 < points; i++) for (let s = 0; s < SIDES; s++) {
      const a = (c * points + i) * SIDES + s, b = (c * points + i) * SIDES + (s + 1) % SIDES;
      index.push(a, b, a + SIDES, b, b + SIDES, a + SIDES);
    }
    geometry.setIndex(index);
    this.mesh = new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ vertexColors: true }));
    this.mesh.frustumCulled = false;
    scene.add(this.mesh);
    this.colour([]);
  }

  // Colours all cables; highlighted ones have the colour `mark`.
  colour(highlighted) {
    const { points, colours, mark } = this, attribute = this.mesh.geometry.attributes.color;
    for (let c = 0; c < colours.length; c++) {
      const { r, g, b } = new THREE.Color(highlighted.includes(c) ? mark : colours[c]);
      for (let i = c * points * SIDES; i < (c + 1) * points * SIDES; i++) attribute.setXYZ(i, r, g, b);
    }
    attribute.needsUpdate = true;
  }

  // Places tubes of a radius around the curves' points `p`.
  update(p, radius) {
    const cables = this.colours.length, points = this.points, { position, normal } = this.mesh.geometry.attributes;
    for (let c = 0; c < cables; c++) {
      let nx = 0.13, ny = 0.29, nz = 0.95;
      for (let i = 0; i < points; i++) {
        const at = 3 * (c * points + i), a = 3 * (c * points + Math.max(i - 1, 0)), b = 3 * (c * points + Math.min(i + 1, points - 1));
        let tx = p[b] - p[a], ty = p[b + 1] - p[a + 1], tz = p[b + 2] - p[a + 2];
        const length = Math.hypot(tx, ty, tz) || 1;
        tx /= length; ty /= length; tz /= length;
        // The last ring's normal, projected off this tangent, avoids twist along the cable.
        const dot = nx * tx + ny * ty + nz * tz;
        nx -= dot * tx; ny -= dot * ty; nz -= dot * tz;
        let size = Math.hypot(nx, ny, nz);
        if (size < 1e-6) { nx = -ty; ny = tx; nz = 0.01; size = Math.hypot(nx, ny, nz); }
        nx /= size; ny /= size; nz /= size;
        const bx = ty * nz - tz * ny, by = tz * nx - tx * nz, bz = tx * ny - ty * nx;
        for (let s = 0; s < SIDES; s++) {
          const angle = 2 * Math.PI * s / SIDES, u = Math.cos(angle), v = Math.sin(angle), k = (c * points + i) * SIDES + s;
          const x = u * nx + v * bx, y = u * ny + v * by, z = u * nz + v * bz;
          position.setXYZ(k, p[at] + radius * x, p[at + 1] + radius * y, p[at + 2] + radius * z);
          normal.setXYZ(k, x, y, z);
        }
      }
    }
    position.needsUpdate = normal.needsUpdate = true;
  }
}
