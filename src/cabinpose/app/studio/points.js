// A frame's cloud and skeletons in the 3D view: both change at once, when the cloud is there. While one is on its way only the newest
// of those asked for meanwhile waits, so that a key that is held piles nothing up. canvas.js unpacks.
import { THREE } from "nicegui-scene";

const POINT_M = 0.008, JOINT_PX = 10;

function disc() { // what makes a joint round
  const canvas = new OffscreenCanvas(32, 32), c = canvas.getContext("2d");
  c.fillStyle = "#fff";
  c.arc(16, 16, 15, 0, 7);
  c.fill();
  return new THREE.CanvasTexture(canvas);
}

export default class FramePoints {
  create_mesh(...wanted) {
    this.mesh = new THREE.Group();
    this.disc = disc();
    this.cloud = new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({ size: POINT_M, vertexColors: true }));
    this.cloud.frustumCulled = false;
    this.skeletons = new THREE.Group();
    this.mesh.add(this.cloud, this.skeletons);
    if (wanted.length) this.show(...wanted);
    return this.mesh;
  }

  async show(url, skeletons, ahead) {
    this.waiting = { url, skeletons, ahead };
    if (this.busy) return;
    this.busy = true;
    while (this.waiting) {
      const wanted = this.waiting;
      this.waiting = null;
      await this.take(wanted);
    }
    this.busy = false;
  }

  async take({ url, skeletons, ahead }) {
    let points = null;
    try {
      const answer = url ? await fetch(url) : null;
      if (answer?.ok) points = this.points(new Uint8Array(await answer.arrayBuffer()), +answer.headers.get("x-points"));
    } catch { /* the studio is gone, which the page tells; the frame's image says what else is wrong */ }
    this.cloud.geometry.dispose();
    this.cloud.geometry = points ?? new THREE.BufferGeometry();
    this.cloud.visible = points !== null;
    this.draw(skeletons);
    for (const next of this.waiting ? [] : ahead) fetch(next).catch(() => null); // into the browser's own store
  }

  points(bytes, count) {
    const plane = (at, wide) => window.studioUnpack(bytes, at, count, wide);
    const place = new Float32Array(3 * count), colour = new Float32Array(3 * count), linear = new THREE.Color();
    const xyz = [0, 2, 4].map((at) => new Int16Array(plane(at * count, true).buffer));
    const rgb = [6, 7, 8].map((at) => plane(at * count, false));
    for (let i = 0; i < count; i++) {
      for (let a = 0; a < 3; a++) place[3 * i + a] = xyz[a][i] / 1000;
      linear.setRGB(rgb[0][i] / 255, rgb[1][i] / 255, rgb[2][i] / 255, THREE.SRGBColorSpace).toArray(colour, 3 * i);
    }
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(place, 3));
    geometry.setAttribute("color", new THREE.BufferAttribute(colour, 3));
    return geometry;
  }

  draw(skeletons) {
    for (const old of [...this.skeletons.children]) { old.geometry.dispose(); old.material.dispose(); this.skeletons.remove(old); }
    for (const { colour, lines, joints } of skeletons) {
      const of = (numbers) => new THREE.BufferGeometry().setAttribute("position", new THREE.Float32BufferAttribute(numbers.flat(2), 3));
      this.skeletons.add(new THREE.LineSegments(of(lines), new THREE.LineBasicMaterial({ color: colour })));
      this.skeletons.add(new THREE.Points(of(joints), new THREE.PointsMaterial({ color: colour, size: JOINT_PX, sizeAttenuation: false, map: this.disc, alphaTest: 0.5 })));
    }
  }
}
