"""Sound inputs of every kind that is read, small and made by our own code: what the mutators start from."""

from __future__ import annotations

import base64
import io
import json
import tempfile
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path

import fuzz_threemf
import numpy as np
import torch
import trimesh
from generator_files import of_instantmesh, of_trellis
from gltf_writer import Gltf
from PIL import Image
from safetensors.numpy import save

KINDS = ("glb", "gltf", "obj", "ply", "stl", "3mf", "npz", "safetensors", "pt", "image", "run", "scene",
         "shape")  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One input.

    kind: of :data:`KINDS`. files: content by name. main: the file that is named to the program.
    """

    kind: str
    files: dict[str, bytes]
    main: str

    def with_file(self, name: str, content: bytes) -> Case:
        """The same with other content in one file."""
        return replace(self, files=self.files | {name: content})

    def write(self, folder: Path) -> Path:
        """Put the files into ``folder``; returns the path of the main one."""
        for name, content in self.files.items():
            (folder / name).write_bytes(content)
        return folder / self.main


@cache
def seeds(kind: str) -> tuple[Case, ...]:
    """All seeds of one kind."""
    return {
        "glb": _glb, "gltf": _gltf, "obj": _obj, "ply": _ply, "stl": _stl, "3mf": _threemf, "npz": _npz,
        "safetensors": _safetensors, "pt": _pt, "image": _image, "run": _run, "scene": _scene, "shape": _shape,
    }[kind]()  # fmt: skip


def ball(subdivisions: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a slightly flattened sphere."""
    mesh = trimesh.creation.icosphere(subdivisions)
    return np.array(mesh.vertices) * (1, 0.8, 0.9), np.array(mesh.faces)


def colours(vertices: np.ndarray) -> np.ndarray:
    """Stripes, ``uint8 [V,3]``."""
    return np.where(np.sin(8 * vertices[:, 1:2]) > 0, [220, 120, 120], [60, 60, 60]).astype(np.uint8)


def uv_of(vertices: np.ndarray) -> np.ndarray:
    """Longitude and height."""
    return np.column_stack([np.arctan2(vertices[:, 0], vertices[:, 2]) / 6.3 + 0.5, 0.5 - vertices[:, 1] / 2])


def texture(mode: str = "RGB") -> Image.Image:
    """Checks of 16 × 16 pixels."""
    squares = (np.indices((16, 16)) // 4).sum(0) % 2 * 200 + 30
    return Image.fromarray(squares.astype(np.uint8)).convert(mode)


def encoded(picture: Image.Image, kind: str = "PNG") -> bytes:
    """The picture as a file."""
    stream = io.BytesIO()
    picture.save(stream, kind)
    return stream.getvalue()


def _textured_gltf() -> Gltf:
    vertices, faces = ball()
    gltf = Gltf()
    attributes = {
        "POSITION": gltf.accessor(vertices.astype(np.float32)),
        "TEXCOORD_0": gltf.accessor(uv_of(vertices).astype(np.float32)),
    }
    picture = {"index": 0, "extensions": {"KHR_texture_transform": {"rotation": 0.1, "scale": [2, 2]}}}
    gltf.tree |= {
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": picture, "baseColorFactor": [1, 0.9, 0.8, 1]},
                       "alphaMode": "MASK", "alphaCutoff": 0.5}],
        "textures": [{"source": gltf.image(np.asarray(texture("RGBA"))), "sampler": 0}],
        "samplers": [{"wrapS": 33071, "magFilter": 9729}],
    }  # fmt: skip
    indices = gltf.accessor(faces.ravel().astype(np.uint16))
    return gltf.mesh({"attributes": attributes, "indices": indices, "material": 0})


def _posed_gltf() -> Gltf:
    """Vertex colours, a sparse accessor, a morph target, a skin, and a node above it."""
    vertices, faces = ball(1)
    gltf, count = Gltf(), len(vertices)
    joints, weights = np.zeros((count, 4), np.uint8), np.tile(np.float32([1, 0, 0, 0]), (count, 1))
    attributes = {
        "POSITION": gltf.accessor(vertices.astype(np.float32)),
        "COLOR_0": gltf.accessor(colours(vertices), normalized=True),
        "JOINTS_0": gltf.accessor(joints),
        "WEIGHTS_0": gltf.accessor(weights),
    }
    rows = {"bufferView": gltf.view(np.uint16([0, 3]).tobytes()), "componentType": 5123}
    moved = {"bufferView": gltf.view(np.float32([[0, 0.1, 0], [0.1, 0, 0]]).tobytes())}
    gltf.tree["accessors"].append({"componentType": 5126, "type": "VEC3", "count": count,
                                   "sparse": {"count": 2, "indices": rows, "values": moved}})  # fmt: skip
    target = {"POSITION": len(gltf.tree["accessors"]) - 1}
    bind = gltf.accessor(np.eye(4, dtype=np.float32).reshape(1, 16))
    primitive = {"attributes": attributes, "indices": gltf.accessor(faces.ravel().astype(np.uint32)),
                 "targets": [target], "mode": 4}  # fmt: skip
    nodes = [{"children": [1, 2], "rotation": [0, 0.6, 0, 0.8]}, {"mesh": 0, "skin": 0, "weights": [0.5]},
             {"translation": [0, 1, 0], "scale": [1, 2, 1]}]  # fmt: skip
    gltf.tree["skins"] = [{"joints": [2], "inverseBindMatrices": bind}]
    return gltf.mesh(primitive, nodes=nodes)


def _glb() -> tuple[Case, ...]:
    def case(gltf: Gltf) -> Case:
        with tempfile.TemporaryDirectory() as folder:
            return Case("glb", {"a.glb": gltf.glb(Path(folder) / "a.glb").read_bytes()}, "a.glb")

    return case(_textured_gltf()), case(_posed_gltf())


def _gltf() -> tuple[Case, ...]:
    found = []
    for gltf in (_textured_gltf(), _posed_gltf()):
        tree = gltf.tree | {"buffers": [{"byteLength": len(gltf.binary), "uri": "a.bin"}]}
        found.append(Case("gltf", {"a.gltf": json.dumps(tree).encode(), "a.bin": gltf.binary}, "a.gltf"))
    inline = "data:application/octet-stream;base64," + base64.b64encode(gltf.binary).decode()
    tree = gltf.tree | {"buffers": [{"byteLength": len(gltf.binary), "uri": inline}]}
    return *found, Case("gltf", {"a.gltf": json.dumps(tree).encode()}, "a.gltf")


def _obj() -> tuple[Case, ...]:
    vertices, faces = ball(1)
    place = [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in vertices]
    uv = [f"vt {u:.4f} {v:.4f}" for u, v in uv_of(vertices)]
    corners = [f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in faces + 1]
    mtl = b"newmtl paint\nKd 0.8 0.7 0.6\nmap_Kd -s 2 2 1 -clamp on paint.png\nnewmtl plain\nKd 0.1 0.2 0.3\n"
    textured = ["mtllib a.mtl", *place, *uv, "usemtl paint", *corners[:60], "usemtl plain", *corners[60:]]
    rgb = colours(vertices) / 255
    painted = [f"{line} {r:.3f} {g:.3f} {b:.3f}" for line, (r, g, b) in zip(place, rgb, strict=True)]
    box = trimesh.creation.box()
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    cube = [f"v {x} {y} {z} {abs(x)} {abs(y)} {y + 0.5}" for x, y, z in box.vertices]
    cube += ["f " + " ".join(str(corner - 8) for corner in ring) for ring in quads]
    return (
        Case("obj", {"a.obj": "\n".join(textured).encode(), "a.mtl": mtl, "paint.png": encoded(texture())}, "a.obj"),
        Case("obj", {"a.obj": "\n".join([*painted, *(f"f {a} {b} {c}" for a, b, c in faces + 1)]).encode()}, "a.obj"),
        Case("obj", {"a.obj": "\n".join(cube).encode()}, "a.obj"),
    )


def _painted_ball(subdivisions: int = 1) -> trimesh.Trimesh:
    vertices, faces = ball(subdivisions)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.visual.vertex_colors = np.column_stack([colours(vertices), np.full(len(vertices), 255)]).astype(np.uint8)
    return mesh


def _ply() -> tuple[Case, ...]:
    vertices, faces = ball(1)
    rows = [f"{x:.4f} {y:.4f} {z:.4f} {u:.3f} {v:.3f}" for (x, y, z), (u, v) in zip(vertices, uv_of(vertices))]
    header = ["ply", "format ascii 1.0", "comment TextureFile paint.png", f"element vertex {len(vertices)}",
              *(f"property float {name}" for name in "xyzst"), f"element face {len(faces)}",
              "property list uchar int vertex_indices", "end_header"]  # fmt: skip
    textured = "\n".join([*header, *rows, *(f"3 {a} {b} {c}" for a, b, c in faces), ""]).encode()
    mesh = _painted_ball()
    return (
        Case("ply", {"a.ply": mesh.export(file_type="ply")}, "a.ply"),
        Case("ply", {"a.ply": mesh.export(file_type="ply", encoding="ascii")}, "a.ply"),
        Case("ply", {"a.ply": textured, "paint.png": encoded(texture())}, "a.ply"),
    )


def _stl() -> tuple[Case, ...]:
    vertices, faces = ball(1)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    binary = bytearray(mesh.export(file_type="stl"))
    binary[:80] = b"COLOR=\xc8\x64\x32\xff".ljust(80)
    for face in range(len(faces)):  # every other triangle has a colour of its own
        binary[84 + 50 * face + 48 : 84 + 50 * face + 50] = (0x7C00 if face % 2 else 0x8000).to_bytes(2, "little")
    text = mesh.export(file_type="stl_ascii")
    return (
        Case("stl", {"a.stl": bytes(binary)}, "a.stl"),
        Case("stl", {"a.stl": text.encode() if isinstance(text, str) else text}, "a.stl"),
    )


def _threemf() -> tuple[Case, ...]:
    vertices, faces = ball(1)
    made = fuzz_threemf.files(vertices, faces, uv_of(vertices), encoded(texture()))
    return tuple(Case("3mf", {"a.3mf": data}, "a.3mf") for data in made)


@cache
def fields() -> tuple[dict[str, np.ndarray], ...]:
    """The arrays of InstantMesh, TRELLIS, and of our own files."""
    ticks = np.linspace(-1, 1, 13)
    phi = np.linalg.norm(np.stack(np.meshgrid(*[ticks] * 3, indexing="ij")), axis=0) - 0.6
    vertices, faces = ball(1)
    own = {"phi": phi.astype(np.float32), "half": np.ones(1), "centre": np.zeros(3), "vertices": 0.6 * vertices,
           "faces": faces, "colours": colours(vertices)}  # fmt: skip
    return of_instantmesh(12), of_trellis(16) | {"resolution": np.array(16)}, own


def _npz() -> tuple[Case, ...]:
    found = []
    for arrays in fields():
        stream = io.BytesIO()
        np.savez_compressed(stream, **arrays)
        found.append(Case("npz", {"a.npz": stream.getvalue()}, "a.npz"))
    return tuple(found)


def _safetensors() -> tuple[Case, ...]:
    whole = [{key: np.ascontiguousarray(array) for key, array in arrays.items()} for arrays in fields()]
    return tuple(Case("safetensors", {"a.safetensors": save(arrays)}, "a.safetensors") for arrays in whole)


def torch_file(content: object) -> bytes:
    """What ``torch.save`` writes."""
    stream = io.BytesIO()
    torch.save(content, stream)
    return stream.getvalue()


def _pt() -> tuple[Case, ...]:
    return tuple(
        Case("pt", {"a.pt": torch_file({key: torch.as_tensor(array) for key, array in arrays.items()})}, "a.pt")
        for arrays in fields()
    )


def _image() -> tuple[Case, ...]:
    deep = Image.fromarray((np.arange(400).reshape(20, 20) * 160).astype(np.uint16))
    files = [encoded(texture()), encoded(texture("RGBA")), encoded(texture("P")), encoded(deep),
             encoded(texture(), "JPEG"), encoded(texture("RGBA"), "WEBP"), encoded(texture(), "TIFF")]  # fmt: skip
    return tuple(Case("image", {"a.png": data}, "a.png") for data in files)


def _run() -> tuple[Case, ...]:
    import yaml

    from genmf_mi.core.config import RefineConfig
    from genmf_mi.geometry.uniform_adam import UniformAdam
    from genmf_mi.pipeline.checkpoint import Checkpoint

    parameter = torch.zeros(5, 3)
    state = Checkpoint.of(3, (parameter,), UniformAdam((parameter,), 0.1), {})
    lines = "".join(json.dumps({"iteration": i, "stage": 1, "loss": 0.5}) + "\n" for i in range(3))
    settings = {"asset": "toy", **RefineConfig().to_dict(), "inputs": {"asset": "a"}}
    metrics = {"after": {"ssim": 0.9}, "relief_mm": {"max": 0.4}, "interrupted": False}
    files = {
        "checkpoint.pt": torch_file(asdict(state)),
        "metrics.jsonl": lines.encode(),
        "config.yaml": yaml.safe_dump(settings, sort_keys=False).encode(),
        "metrics.json": json.dumps(metrics).encode(),
    }
    return tuple(Case("run", files, name) for name in files)


def _scene() -> tuple[Case, ...]:
    from genmf_mi.render import scene_file

    return (Case("scene", {"a.xml": scene_file.standalone_xml("default", "mesh.ply").encode()}, "a.xml"),)


_VERTEX = np.dtype([("at", "<f8", 3), ("rgb", "u1", 3)])
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


def shape_file(vertices: np.ndarray, faces: np.ndarray, rgb: np.ndarray) -> bytes:
    """A binary PLY file with double coordinates and colours per vertex."""
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}",
              *(f"property double {name}" for name in "xyz"),
              *(f"property uchar {name}" for name in ("red", "green", "blue")),
              f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header", ""]  # fmt: skip
    points, triangles = np.zeros(len(vertices), _VERTEX), np.zeros(len(faces), _FACE)
    points["at"], points["rgb"], triangles["count"], triangles["corners"] = vertices, rgb, 3, faces
    return "\n".join(header).encode() + points.tobytes() + triangles.tobytes()


def shape_arrays(data: bytes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, faces and colours of :func:`shape_file`."""
    head, _, rest = data.partition(b"end_header\n")
    count = int(head.partition(b"element vertex ")[2].split()[0])
    points = np.frombuffer(rest, _VERTEX, count)
    triangles = np.frombuffer(rest, _FACE, offset=points.nbytes)
    return points["at"].copy(), triangles["corners"].astype(np.int64), points["rgb"].copy()


def _shape() -> tuple[Case, ...]:
    found = []
    box = trimesh.creation.box().subdivide().subdivide()
    torus = trimesh.creation.torus(1, 0.3, major_sections=16, minor_sections=8)
    for vertices, faces in (ball(2), (box.vertices, box.faces), (torus.vertices, torus.faces), ball(3)):
        points = np.array(vertices, dtype=np.float64)
        found.append(Case("shape", {"a.ply": shape_file(points, np.array(faces), colours(points))}, "a.ply"))
    return tuple(found)
