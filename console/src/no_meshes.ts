/** In place of the loaders of meshes, which the page never asks for. */
class NoMeshes {}
export { NoMeshes as ColladaLoader, NoMeshes as STLLoader };
