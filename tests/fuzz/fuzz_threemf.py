"""Sound 3MF files, written by hand."""

from __future__ import annotations

import io
import zipfile

import numpy as np


def files(vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray, picture: bytes) -> tuple[bytes, bytes]:
    """One whose triangles have colours, and one with a texture."""
    points = "".join(f'<vertex x="{x:.3f}" y="{y:.3f}" z="{z:.3f}"/>' for x, y, z in 20 * vertices)

    def model(resources: str, triangles: str) -> bytes:
        return (
            '<?xml version="1.0" encoding="UTF-8"?><model unit="millimeter" xml:lang="en-US" '
            'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" '
            'xmlns:m="http://schemas.microsoft.com/3dmanufacturing/material/2015/02"><resources>'
            f'{resources}<object id="3" type="model"><mesh><vertices>{points}</vertices>'
            f'<triangles>{triangles}</triangles></mesh></object><object id="4" type="model"><components>'
            '<component objectid="3" transform="1 0 0 0 1 0 0 0 1 5 6 7"/></components></object></resources>'
            '<build><item objectid="4"/></build></model>'
        ).encode()

    def archive(*members: tuple[str, bytes]) -> bytes:
        stream = io.BytesIO()
        types = (
            '<?xml version="1.0"?><Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">'
            '<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>'
            '<Default Extension="png" ContentType="image/png"/><Default Extension="model" '
            'ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>'
        )
        relation = (
            '<?xml version="1.0"?><Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
            '<Relationship Target="{}" Id="rel0" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/{}"/>'
            "</Relationships>"
        )
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as file:
            file.writestr(zipfile.ZipInfo("[Content_Types].xml"), types)
            file.writestr(zipfile.ZipInfo("_rels/.rels"), relation.format("/3D/3dmodel.model", "3dmodel"))
            if len(members) > 1:
                file.writestr(
                    zipfile.ZipInfo("3D/_rels/3dmodel.model.rels"), relation.format("/3D/Texture/a.png", "3dtexture")
                )
            for name, content in members:
                file.writestr(zipfile.ZipInfo(name), content)
        return stream.getvalue()

    painted = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}" pid="2" p1="{a % 2}"/>' for a, b, c in faces)
    group = '<m:colorgroup id="2"><m:color color="#C86432FF"/><m:color color="#202020FF"/></m:colorgroup>'
    mapped = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}" pid="2" p1="{a}" p2="{b}" p3="{c}"/>' for a, b, c in faces)
    coordinates = "".join(f'<m:tex2coord u="{u:.3f}" v="{v:.3f}"/>' for u, v in uv)
    image = (
        '<m:texture2d id="1" path="/3D/Texture/a.png" contenttype="image/png" tilestyleu="mirror"/>'
        f'<m:texture2dgroup id="2" texid="1">{coordinates}</m:texture2dgroup>'
    )
    return (
        archive(("3D/3dmodel.model", model(group, painted))),
        archive(("3D/3dmodel.model", model(image, mapped)), ("3D/Texture/a.png", picture)),
    )
