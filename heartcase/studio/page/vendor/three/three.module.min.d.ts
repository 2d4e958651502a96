// What the page uses of three.js, for the check of its types; three.js itself has none here.
declare class Thing {
  constructor(...given: any[]);
  [name: string]: any;
}
export class BoxGeometry extends Thing {}
export class BufferAttribute extends Thing {}
export class BufferGeometry extends Thing {}
export class CatmullRomCurve3 extends Thing {}
export class Data3DTexture extends Thing {}
export class DataTexture extends Thing {}
export class Group extends Thing {}
export class InterleavedBuffer extends Thing {}
export class InterleavedBufferAttribute extends Thing {}
export class LineBasicMaterial extends Thing {}
export class LineSegments extends Thing {}
export class Line extends Thing {}
export class Matrix3 extends Thing {}
export class Matrix4 extends Thing {}
export class Mesh extends Thing {}
export class MeshLambertMaterial extends Thing {}
export class MeshBasicMaterial extends Thing {}
export class AmbientLight extends Thing {}
export class DirectionalLight extends Thing {}
export class PerspectiveCamera extends Thing {}
export class Plane extends Thing {}
export class PlaneGeometry extends Thing {}
export class Points extends Thing {}
export class PointsMaterial extends Thing {}
export class Quaternion extends Thing {}
export class RawShaderMaterial extends Thing {}
export class Scene extends Thing {}
export class Sphere extends Thing {}
export class SphereGeometry extends Thing {}
export class Texture extends Thing {}
export class TubeGeometry extends Thing {}
export class Vector3 extends Thing {}
export class Vector4 extends Thing {}
export class WebGLRenderTarget extends Thing {}
export class WebGLRenderer extends Thing {}
export const AlwaysStencilFunc: any;
export const BackSide: any;
export const DecrementWrapStencilOp: any;
export const DoubleSide: any;
export const DynamicDrawUsage: any;
export const FloatType: any;
export const FrontSide: any;
export const GLSL3: any;
export const IncrementWrapStencilOp: any;
export const KeepStencilOp: any;
export const LinearFilter: any;
export const LinearMipmapLinearFilter: any;
export const NearestFilter: any;
export const NotEqualStencilFunc: any;
export const RedFormat: any;
export const RGBAFormat: any;
export const RGFormat: any;
export const UnsignedByteType: any;
export const ZeroStencilOp: any;
