// The bodies of a scene in the 3D view: cabin, people, things, and marks beside them. What is the same is kept; all that is new
// is fetched first and then shown at once, so that what is seen together belongs together.
import { THREE, CSS2DObject } from "nicegui-scene";

const kept = new Map(); // url -> promise of bytes
const MOST_KEPT = 80;
const MEASURED = "#5ee0ff";
const MIDDLE_AND_STEP = 16; // bytes

function bytes_of(url) {
  const known = kept.get(url);
  if (known) return known;
  const bytes = fetch(url).then((answer) => {
    if (!answer.ok) throw new Error(`${url}: ${answer.status}`);
    return answer.arrayBuffer();
  });
  bytes.catch(() => kept.delete(url));
  kept.set(url, bytes);
  if (kept.size > MOST_KEPT) kept.delete(kept.keys().next().value);
  return bytes;
}

export default class SceneBodies {
  create_mesh(...given) {
    this.mesh = new THREE.Group();
    this.bodies = new Map(); // name -> { shape, points, object, geometries }
    this.marks = new THREE.Group();
    this.mesh.add(this.marks);
    this.asked = 0;
    if (given.length) this.show(...given);
    return this.mesh;
  }

  // bodies: by name the addresses `shape` and `points`, `looks` [colour, opacity], `far` m; marks: `lines`, `balls`, `words`.
  async show(number, bodies, marks) {
    const asked = ++this.asked;
    let fetched;
    try {
      fetched = await Promise.all(Object.entries(bodies).map(async ([name, body]) =>
        [name, body, ...(await Promise.all([bytes_of(body.shape), bytes_of(body.points)]))]));
    } catch {
      return; // it was let go on the server, since there is a newer one on its way
    }
    if (asked !== this.asked) return;
    for (const [name, held] of this.bodies) if (!(name in bodies)) this.take_out(name, held);
    for (const [name, body, shape, points] of fetched) this.put(name, body, shape, points);
    this.mark(marks);
    this.mesh.userData.number = number;
  }

  put(name, body, shape, points) {
    let held = this.bodies.get(name);
    if (held && held.shape !== body.shape) { this.take_out(name, held); held = undefined; }
    if (!held) {
      held = { ...this.built(body, shape), shape: body.shape };
      this.bodies.set(name, held);
      this.mesh.add(held.object);
    }
    if (held.points === body.points) return;
    held.points = body.points;
    const [x, y, z, step] = new Float32Array(points, 0, 4);
    const count = (points.byteLength - MIDDLE_AND_STEP) / 9; // three coordinates of 2 bytes and a normal of 3
    const position = new THREE.BufferAttribute(new Int16Array(points, MIDDLE_AND_STEP, 3 * count), 3);
    const normal = new THREE.BufferAttribute(new Int8Array(points, MIDDLE_AND_STEP + 6 * count, 3 * count), 3, true);
    for (const geometry of held.geometries) {
      geometry.setAttribute("position", position);
      geometry.setAttribute("normal", normal);
      geometry.computeBoundingSphere();
    }
    held.object.position.set(x, y, z);
    held.object.scale.setScalar(step);
  }

  built({ looks, far }, shape) {
    const words = new Uint32Array(shape), groups = words[0], levels = groups / looks.length;
    const materials = looks.map(([color, opacity]) => new THREE.MeshLambertMaterial(
      opacity < 1 ? { color, opacity, transparent: true, depthWrite: false } : { color }));
    const object = levels > 1 ? new THREE.LOD() : new THREE.Group();
    const geometries = [];
    for (let level = 0, from = 1 + groups; level < levels; level++) {
      const geometry = new THREE.BufferGeometry(), first = from;
      for (let look = 0; look < looks.length; look++) {
        const length = words[1 + level * looks.length + look];
        if (length) geometry.addGroup(from - first, length, look);
        from += length;
      }
      geometry.setIndex(new THREE.BufferAttribute(words.slice(first, from), 1));
      geometries.push(geometry);
      const mesh = new THREE.Mesh(geometry, materials);
      if (levels > 1) object.addLevel(mesh, level * far, 0.05); else object.add(mesh);
    }
    return { object, geometries, materials };
  }

  take_out(name, { object, geometries, materials }) {
    object.removeFromParent();
    for (const each of [...geometries, ...materials]) each.dispose();
    this.bodies.delete(name);
  }

  mark({ lines, balls, measures, words }) {
    const key = JSON.stringify([lines, balls, measures, words]);
    if (key === this.marked) return;
    this.marked = key;
    for (const each of [...this.marks.children]) { each.removeFromParent(); each.geometry?.dispose(); each.material?.dispose(); }
    for (const [color, ...ends] of lines) {
      const geometry = new THREE.BufferGeometry().setFromPoints(ends.map((end) => new THREE.Vector3(...end)));
      this.marks.add(new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ color })));
    }
    for (const [color, radius, place] of balls) {
      const material = new THREE.MeshLambertMaterial({ color, transparent: true, opacity: 0.6 });
      const ball = new THREE.Mesh(new THREE.SphereGeometry(radius, 16, 12), material);
      ball.position.set(...place);
      this.marks.add(ball);
    }
    for (const ends of measures) {
      const points = ends.map((end) => new THREE.Vector3(...end)), along = points[1].clone().sub(points[0]);
      const material = new THREE.MeshBasicMaterial({ color: MEASURED, depthTest: false, transparent: true });
      const bar = new THREE.Mesh(new THREE.CylinderGeometry(0.006, 0.006, along.length()), material);
      bar.position.copy(points[0]).addScaledVector(along, 0.5);
      bar.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), along.normalize());
      const caps = points.map((end) => {
        const cap = new THREE.Mesh(new THREE.SphereGeometry(0.016, 12, 8), material);
        cap.position.copy(end);
        return cap;
      });
      for (const each of [bar, ...caps]) { each.renderOrder = 1; this.marks.add(each); }
    }
    for (const [text, place] of words) {
      const element = document.createElement("div");
      element.className = "studio-dimension";
      element.textContent = text;
      const label = new CSS2DObject(element);
      label.position.set(...place);
      label.center.set(-0.06, 0.5); // beside the line
      this.marks.add(label);
    }
  }
}
