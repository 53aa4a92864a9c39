"""glTF 2.0, binary and JSON: geometry, base colour and maps, with nothing left out silently.

General mesh readers drop what changes the colour without changing the shape: sampler wrap modes, KHR_texture_transform,
the second UV set, the product of texture and COLOR_0, sparse and quantised accessors. Here every one of them is
honoured, and what is not supported is refused by name. Section numbers below are those of the Khronos glTF 2.0
specification.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from genmf_mi.assets.albedo import CLAMP, MIRROR, REPEAT, Material, Texture
from genmf_mi.assets.formats.gltf_data import GltfData
from genmf_mi.assets.formats.gltf_maps import emission_is_the_colour, emission_of, maps_of
from genmf_mi.assets.part import Part, decode_alpha, decode_image
from genmf_mi.assets.reading import current
from genmf_mi.core.errors import AssetError

_WRAP = {10497: REPEAT, 33071: CLAMP, 33648: MIRROR}
_SUPPORTED = {
    "EXT_texture_webp",
    "KHR_draco_mesh_compression",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
}
_FARTHEST = 1e6
"""Numbers of a texture transform."""
_HARMLESS = ("KHR_materials_", "KHR_lights_", "KHR_xmp", "KHR_animation", "EXT_lights_")


def read(path: Path) -> list[Part]:
    """All triangles of the default scene, in the file's own units.

    Raises:
        AssetError: the file is truncated, not glTF 2.0, or needs an extension that is not supported.
    """
    return _Reader(path).parts()


class _Reader:
    def __init__(self, path: Path) -> None:
        self.path, self.data = path, GltfData(path)
        self.tree = self.data.tree
        unknown = [
            name
            for name in self.tree.get("extensionsRequired", [])
            if name not in _SUPPORTED and not name.startswith(_HARMLESS)
        ]
        if unknown:
            raise AssetError(
                f"{path} needs the glTF extension {', '.join(unknown)}, which is not supported. "
                "Export it again without compression or special textures."
            )
        self.materials: dict[tuple[int | None, bool], tuple[Material, int, bool]] = {}
        self.images: dict[int, np.ndarray] = {}

    def parts(self) -> list[Part]:
        nodes = self.tree.get("nodes", [])
        scenes = self.tree.get("scenes", [])
        if scenes:
            roots = scenes[self.tree.get("scene", 0)].get("nodes", [])
        else:
            children = {child for node in nodes for child in node.get("children", [])}
            roots = [index for index in range(len(nodes)) if index not in children]
        world = {}
        pending = [(root, np.eye(4)) for root in roots]
        while pending:
            index, above = pending.pop()
            if index in world:
                raise AssetError(f"{self.path}: node {index} has two parents. Export the file again.")
            world[index] = above @ _matrix(nodes[index])
            pending += [(child, world[index]) for child in nodes[index].get("children", [])]
        parts = []
        for index in sorted(world):
            node = nodes[index]
            if "mesh" not in node:
                continue
            mesh = self.tree["meshes"][node["mesh"]]
            weights = node.get("weights", mesh.get("weights", []))
            for primitive in mesh["primitives"]:
                if primitive.get("mode", 4) not in (4, 5, 6):
                    continue  # points and lines have no surface
                names = tuple(str(one["name"]) for one in (node, mesh) if one.get("name"))
                part = replace(self.primitive(primitive, weights), names=(tuple(dict.fromkeys(names)),))
                current().take_faces(len(part.faces), self.path)
                if "skin" in node and "JOINTS_0" in primitive["attributes"]:
                    parts.append(self.posed(part, primitive["attributes"], self.tree["skins"][node["skin"]], world))
                else:
                    parts.append(part.transformed(world[index]))
        return parts

    def primitive(self, primitive: dict, weights: list[float]) -> Part:
        attributes = primitive["attributes"]
        read, indices = self.data.accessor, primitive.get("indices")
        if "KHR_draco_mesh_compression" in primitive.get("extensions", {}):
            decoded = self.data.draco(primitive)
            indices = primitive["indices"]

            def read(index: int) -> np.ndarray:
                return decoded[index] if index in decoded else self.data.accessor(index)

        vertices = read(attributes["POSITION"]).astype(np.float64)
        for weight, target in zip(weights, primitive.get("targets", [])):
            if weight and "POSITION" in target:
                vertices = vertices + weight * self.data.accessor(target["POSITION"])
        order = np.arange(len(vertices)) if indices is None else read(indices).astype(np.int64).ravel()
        faces = _triangles(order, primitive.get("mode", 4))
        if len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices):
            raise AssetError(f"{self.path} has faces that point to missing vertices. Export it again.")
        colours = attributes.get("COLOR_0")
        material, uv_set, emission = self.material(primitive.get("material"), coloured=colours is not None)
        uv = attributes.get(f"TEXCOORD_{uv_set}")
        if material.texture is not None and uv is None:
            raise AssetError(
                f"{self.path} has a texture but no texture coordinates (TEXCOORD_{uv_set}). "
                "Unwrap it and export it again."
            )

        place = None if uv is None else read(uv).astype(np.float64)
        if place is not None and place.shape[1] != 2:
            raise AssetError(f"{self.path} is damaged: its texture coordinates are no pairs. Export it again.")

        def attribute(name: str) -> np.ndarray | None:
            return read(attributes[name]) if name in attributes else None

        whole = {} if primitive.get("material") is None else self.tree["materials"][primitive["material"]]
        maps, notes = maps_of(whole, self.map_texture, attribute, emission=emission)
        return Part(
            vertices,
            faces,
            material,
            place,
            None if colours is None else read(colours)[:, :3].astype(np.float32),
            maps,
            tuple(notes),
        )

    def posed(self, part: Part, attributes: dict, skin: dict, world: dict[int, np.ndarray]) -> Part:
        """A skinned part in the pose of the file; its node's own transform does not apply (3.7.3.3)."""
        joints = np.stack([world[joint] for joint in skin["joints"]])
        if "inverseBindMatrices" in skin:
            joints = joints @ self.data.accessor(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
        weights = self.data.accessor(attributes["WEIGHTS_0"]).astype(np.float64)
        weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-12)
        blend = np.einsum("vk,vkij->vij", weights, joints[self.data.accessor(attributes["JOINTS_0"]).astype(np.int64)])
        vertices = np.einsum("vij,vj->vi", blend[:, :3, :3], part.vertices) + blend[:, :3, 3]
        return replace(part, vertices=vertices, maps=part.maps.turned(blend[:, :3, :3]))

    def material(self, index: int | None, *, coloured: bool) -> tuple[Material, int, bool]:
        """The base colour of a material, the UV set that its texture uses, and whether it gives off light beside it.

        coloured: whether the vertices have colours.
        """
        key = index, coloured
        if key not in self.materials:
            self.materials[key] = self._material({} if index is None else self.tree["materials"][index], coloured)
        return self.materials[key]

    def _material(self, material: dict, coloured: bool) -> tuple[Material, int, bool]:
        surface = material.get("pbrMetallicRoughness", {})
        factor, image = surface.get("baseColorFactor", [1, 1, 1, 1]), surface.get("baseColorTexture")
        glossy = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness")
        if glossy is not None:
            factor, image = glossy.get("diffuseFactor", [1, 1, 1, 1]), glossy.get("diffuseTexture")
        light = material.get("emissiveTexture")
        # A picture that is both is meant once
        glows = any(emission_of(material)) and not (image and light and self._same(image, light))
        if glows and image is None and not coloured:
            picture = None if light is None else self.image(self._source(light))
            if emission_is_the_colour(material, factor, picture):
                # Shadeless scans have their picture there, on a base of one colour
                factor, image, glows = [*material["emissiveFactor"], 1], light, False
        mode = material.get("alphaMode", "OPAQUE")
        cutoff = {"MASK": float(material.get("alphaCutoff", 0.5)), "BLEND": 0.5}.get(mode)
        red, green, blue = map(float, np.clip(factor[:3], 0, 1))  # what the format allows (3.9.2)
        opacity = float(factor[3]) if len(factor) > 3 else 1.0
        name = str(material.get("name", ""))
        if image is None:
            return Material((red, green, blue), None, cutoff, opacity, name), 0, glows
        texture, uv_set = self.map_texture(image, transparent=cutoff is not None)
        return Material((red, green, blue), texture, cutoff, opacity, name), uv_set, glows

    def map_texture(self, image: dict, *, transparent: bool = False) -> tuple[Texture, int]:
        """A texture that a material refers to, and the UV set that it uses."""
        transform = image.get("extensions", {}).get("KHR_texture_transform", {})
        uv_set = transform.get("texCoord", image.get("texCoord", 0))
        texture = self._texture(image, transform, transparent=transparent)
        if not np.abs(texture.transform).max() < _FARTHEST:  # or NaN
            raise AssetError(f"{self.path} moves a texture by what is no sensible number. Export it again.")
        return texture, uv_set

    def _same(self, one: dict, other: dict) -> bool:
        """Whether two references are to the same texture, or to entries that say the same."""
        entries = dict(enumerate(self.tree["textures"]))
        first, second = one.get("index", -1), other.get("index", -2)
        return first == second or entries.get(first) == entries.get(second, {})

    def _source(self, image: dict) -> int:
        """The image behind a reference to a texture."""
        entry = self.tree["textures"][image["index"]]
        source = entry.get("extensions", {}).get("EXT_texture_webp", entry).get("source", entry.get("source"))
        if source is None:
            raise AssetError(f"{self.path} has a texture of a kind that is not supported. Export it with PNG or JPEG.")
        return source

    def _texture(self, image: dict, transform: dict, *, transparent: bool) -> Texture:
        entry, source = self.tree["textures"][image["index"]], self._source(image)
        sampler = self.tree["samplers"][entry["sampler"]] if "sampler" in entry else {}
        along_u, along_v = (_WRAP[sampler.get(key, 10497)] for key in ("wrapS", "wrapT"))
        nearest = sampler.get("magFilter") == 9728
        pixels = self.image(source)
        alpha = decode_alpha(self.image_file(source)) if transparent else None
        return Texture(pixels, (along_u, along_v), nearest, _uv_transform(transform), alpha)

    def image(self, index: int) -> np.ndarray:
        if index not in self.images:
            name = self.tree["images"][index].get("name") or f"number {index} in {self.path}"
            self.images[index] = decode_image(self.image_file(index), name)
        return self.images[index]

    def image_file(self, index: int) -> bytes:
        image = self.tree["images"][index]
        return bytes(self.data.view(image["bufferView"]) if "bufferView" in image else self.data.resource(image["uri"]))


def _matrix(node: dict) -> np.ndarray:
    """The local transform of a node, ``[4,4]`` (3.5.3)."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = np.array(node.get("rotation", [0, 0, 0, 1]), dtype=np.float64)
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, :3] *= node.get("scale", [1, 1, 1])
    matrix[:3, 3] = node.get("translation", [0, 0, 0])
    return matrix


def _uv_transform(extension: dict) -> np.ndarray:
    """KHR_texture_transform as ``[2,3]``: translation · rotation · scale.

    Counter-clockwise as seen in an image whose v points down. The matrix printed in the extension's text turns the
    other way; viewers and the conformance model do as this does.
    """
    angle = extension.get("rotation", 0.0)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return np.column_stack([turn * extension.get("scale", [1, 1]), extension.get("offset", [0, 0])])


def _triangles(order: np.ndarray, mode: int) -> np.ndarray:
    """Triangles ``[F,3]`` of a list (4), a strip (5) or a fan (6) of indices (3.7.2.1)."""
    if mode == 4:
        return order[: len(order) // 3 * 3].reshape(-1, 3)
    first, second, third = order[:-2], order[1:-1], order[2:]
    if mode == 6:
        return np.stack([np.broadcast_to(order[0], second.shape), second, third], axis=1)
    odd = np.arange(len(first)) % 2 == 1
    return np.stack([first, np.where(odd, third, second), np.where(odd, second, third)], axis=1)
