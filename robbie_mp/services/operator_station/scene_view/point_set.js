import { THREE } from "nicegui-scene";

const STEP_M = 0.01;

function unpacked(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return Float32Array.from(new Int16Array(bytes.buffer), (steps) => steps * STEP_M);
}

export default class PointSet {
  create_mesh(points, size_px) {
    const geometry = new THREE.BufferGeometry();
    this.mesh = size_px
      ? new THREE.Points(geometry, new THREE.PointsMaterial({ size: size_px, sizeAttenuation: false }))
      : new THREE.Line(geometry, new THREE.LineBasicMaterial());
    // Or it would be left out of the picture by where the first points were.
    this.mesh.frustumCulled = false;
    this.set_points(points);
    return this.mesh;
  }

  set_points(points) {
    const position = new THREE.BufferAttribute(unpacked(points), 3);
    this.mesh.geometry.dispose();
    this.mesh.geometry = new THREE.BufferGeometry().setAttribute("position", position);
  }
}
