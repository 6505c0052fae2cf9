export {
  AmbientLight, ArrowHelper, BufferAttribute, BufferGeometry, Color, CylinderGeometry, DirectionalLight, DoubleSide,
  EdgesGeometry, Group, HemisphereLight, InstancedMesh, LineBasicMaterial, LineDashedMaterial, LineSegments, Matrix4, Mesh,
  MeshBasicMaterial, MeshLambertMaterial, MeshStandardMaterial, OrthographicCamera, PerspectiveCamera, Quaternion, Raycaster, Scene, Sphere, Box3,
  SphereGeometry, Sprite, SpriteMaterial, CanvasTexture, TorusGeometry, Vector2, Vector3, WebGLRenderer, REVISION,
} from "three";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
