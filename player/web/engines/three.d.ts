/** What player/web/engines uses of three.js, which has no types of its own. */

export class Vector3 {
  set(x: number, y: number, z: number): this;
  fromArray(array: ArrayLike<number>, offset?: number): this;
}

export class Quaternion {
  set(x: number, y: number, z: number, w: number): this;
  setFromRotationMatrix(matrix: Matrix4): this;
}

export class Matrix4 {
  makeBasis(x: Vector3, y: Vector3, z: Vector3): this;
}

export class Color {
  r: number;
  g: number;
  b: number;
}

export class Object3D {
  position: Vector3;
  quaternion: Quaternion;
  add(...objects: Object3D[]): this;
  removeFromParent(): this;
}

export class PerspectiveCamera extends Object3D {
  constructor(fov: number, aspect: number, near: number, far: number);
}
