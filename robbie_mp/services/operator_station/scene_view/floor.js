import { THREE } from "nicegui-scene";

const loader = new THREE.TextureLoader();

export default class Floor {
  create_mesh(floor) {
    const material = new THREE.MeshBasicMaterial({ transparent: true, side: THREE.DoubleSide });
    this.mesh = new THREE.Mesh(new THREE.PlaneGeometry(1, 1), material);
    this.mesh.visible = false;
    this.set_floor(floor);
    return this.mesh;
  }

  set_floor(floor) {
    this.wanted = floor;
    if (!floor) this.mesh.visible = false;
    else loader.load(floor[0], (texture) => this.show(floor, texture));
  }

  show(floor, texture) {
    if (this.wanted !== floor) return texture.dispose();
    const [, width_m, height_m, [x, y, yaw_rad]] = floor;
    texture.flipY = false; // the first row of cells has the least y
    texture.magFilter = THREE.NearestFilter;
    texture.colorSpace = THREE.SRGBColorSpace;
    this.mesh.material.map?.dispose();
    this.mesh.material.map = texture;
    this.mesh.material.needsUpdate = true;
    this.mesh.scale.set(width_m, height_m, 1);
    this.mesh.rotation.z = yaw_rad;
    const cosine = Math.cos(yaw_rad) / 2, sine = Math.sin(yaw_rad) / 2;
    this.mesh.position.set(x + width_m * cosine - height_m * sine, y + width_m * sine + height_m * cosine, 0);
    this.mesh.visible = true;
  }
}
