"""Files for the rows on 3MF."""

from __future__ import annotations

import io
import zipfile

import numpy as np

import shapes
from mesh_bytes import threemf_text
from supported import row


def package(text: str, **parts: str) -> bytes:
    """Return a 3MF of a model and further parts, by their names with ``__`` for slashes and ``_dot_`` for dots."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("3D/3dmodel.model", text)
        for name, content in parts.items():
            archive.writestr(name.replace("__", "/").replace("_dot_", "."), content)
    return buffer.getvalue()


def mesh_xml(*meshes) -> str:
    points, triangles = shapes.together(*meshes)
    return (
        "<mesh><vertices>" + "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in points)
        + "</vertices><triangles>" + "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in triangles)
        + "</triangles></mesh>"
    )  # fmt: skip


def model(objects: str, items: str = '<item objectid="1"/>', attributes: str = "") -> str:
    return (
        f'<model unit="millimeter" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" {attributes}>'
        f"<resources>{objects}</resources><build>{items}</build></model>"
    )


def object_xml(number: int, *meshes, more: str = "", type_: str = "model") -> str:
    return f'<object id="{number}" type="{type_}">{mesh_xml(*meshes)}{more}</object>'


BAR = shapes.box((100, 20, 10))
#: Takes the upper half of the bar away over 60 of its 100 mm: 60 · 20 · 5 of 20,000 mm³.
CUTTER = shapes.box((60, 40, 40), centre=(0, 0, 20))
NOTCHED = 14_000


@row("3MF", "build items, components, transforms, units")
def _():
    yield "a.3mf", package(threemf_text("inch")), lambda mesh: (mesh.unit_m, mesh.parts) == (0.0254, 2)
    yield "a.3mf", package(threemf_text("inch")), 16 / 6


@row("3MF", "models in parts of their own (production extension)")
def _():
    root = model(
        '<object id="9" type="model"><components><component p:path="/3D/Objects/o.model" objectid="1" '
        'transform="1 0 0 0 1 0 0 0 2 0 0 0"/></components></object>',
        '<item objectid="9"/>',
        'xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06" requiredextensions="p"',
    )
    part = model(object_xml(1, BAR), "")
    yield "a.3mf", package(root, **{"3D__Objects__o_dot_model": part}), 40_000
    # The start part is the one that the package names, whatever its name and place.
    relationships = (
        '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship Id="r" '
        'Target="/3D/root.model" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
    )
    parts = {"3D__Objects__o_dot_model": part, "3D__root_dot_model": root, "_rels__dot_rels": relationships}
    parts["_rels/.rels"] = parts.pop("_rels__dot_rels")
    yield "a.3mf", package(model(object_xml(1, CUTTER)), **parts), 40_000


@row("3MF", "objects of type `model` and `surface`")
def _():
    for type_ in ("model", "surface"):
        yield "a.3mf", package(model(object_xml(1, BAR, type_=type_))), 20_000


@row("3MF", "objects of type `support`, `solidsupport`, `other`")
def _():
    for type_ in ("support", "solidsupport", "other"):
        both = object_xml(1, BAR) + object_xml(2, CUTTER, type_=type_)
        said = f"left out 1 object of type {type_}"
        yield "a.3mf", package(model(both, '<item objectid="1"/><item objectid="2"/>')), 20_000, said
        parts = '<component objectid="1"/><component objectid="2"/>'
        whole = f'<object id="3" type="model"><components>{parts}</components></object>'
        yield "a.3mf", package(model(both + whole, '<item objectid="3"/>')), 20_000, said
    alone = package(model(object_xml(1, BAR, type_="support")))
    yield "a.3mf", alone, "holds no vertices (left out 1 object of type support)", "Export it again"


@row("3MF", 'items that are not printed (`printable="0"`)')
def _():
    items = '<item objectid="1" printable="1"/><item objectid="2" printable="0"/>'
    both = package(model(object_xml(1, BAR) + object_xml(2, CUTTER), items))
    yield "a.3mf", both, 20_000, "left out 1 object that is not printed"


def prusa(*volumes: tuple[str, str]) -> dict[str, str]:
    """Return the settings that give a key and a value to each twelve triangles of object 1."""
    text = "".join(
        f'<volume firstid="{12 * at}" lastid="{12 * at + 11}">'
        f'<metadata type="volume" key="{key}" value="{value}"/></volume>'
        for at, (key, value) in enumerate(volumes)
    )
    return {"Metadata__Slic3r_PE_model_dot_config": f'<config><object id="1">{text}</object></config>'}


def bambu(kind: str) -> tuple[str, dict[str, str]]:
    """Return a model of two components, and the settings that name the kind of the second."""
    both = object_xml(1, BAR) + object_xml(2, CUTTER, type_="model" if kind == "normal_part" else "other")
    components = '<component objectid="1"/><component objectid="2"/>'
    whole = f'<object id="3" type="model"><components>{components}</components></object>'
    parts = f'<part id="1" subtype="normal_part"/><part id="2" subtype="{kind}"/>'
    config = f'<config><object id="3">{parts}</object></config>'
    return model(both + whole, '<item objectid="3" transform="1 0 0 0 1 0 0 0 1 50 50 5"/>'), {
        "Metadata__model_settings_dot_config": config
    }


@row("3MF", "negative volumes of slicers")
def _():
    two = model(object_xml(1, BAR, CUTTER))
    said = "subtracted 1 negative volume"
    roles = (("volume_type", "ModelPart"), ("volume_type", "NegativeVolume"))
    yield "a.3mf", package(two, **prusa(*roles)), NOTCHED, said
    yield (
        "a.3mf",
        package(two, **prusa(*roles)),
        lambda mesh: np.ptp(mesh.vertices, axis=0).tolist() == [100, 20, 10],
    )
    text, config = bambu("negative_part")
    yield "a.3mf", package(text, **config), NOTCHED, said
    open_bar = (BAR[0], BAR[1][1:])
    damaged = package(model(object_xml(1, open_bar, CUTTER)), **{
        "Metadata__Slic3r_PE_model_dot_config": '<config><object id="1"><volume firstid="11" lastid="22">'
        '<metadata key="volume_type" value="NegativeVolume"/></volume></object></config>'
    })  # fmt: skip
    yield "a.3mf", damaged, "a negative volume, which cannot be subtracted", "mesh editor"


@row("3MF", "modifiers, support blockers and enforcers of slicers")
def _():
    two, said = model(object_xml(1, BAR, CUTTER)), "left out 1 modifier of a slicer"
    part = ("volume_type", "ModelPart")
    for other in (
        *(("volume_type", kind) for kind in ("ParameterModifier", "SupportEnforcer", "SupportBlocker")),
        ("modifier", "1"),
    ):
        yield "a.3mf", package(two, **prusa(part, other)), 20_000, said
    for kind in ("modifier_part", "support_enforcer", "support_blocker"):
        text, config = bambu(kind)
        yield "a.3mf", package(text, **config), 20_000, said
    inside = '<s:volumes><s:volume ts="0" te="11" modifier="0"/><s:volume ts="12" te="23" modifier="1"/></s:volumes>'
    text = model(object_xml(1, BAR, CUTTER).replace("</mesh>", f"{inside}</mesh>"), attributes='xmlns:s="s"')
    yield "a.3mf", package(text), 20_000, said
    text, config = bambu("normal_part")
    yield "a.3mf", package(text, **config), 20_000 + 60 * 40 * 40
    broken = package(two, Metadata__model_settings_dot_config="<config>")
    yield "a.3mf", broken, 20_000 + 60 * 40 * 40, "settings metadata/model_settings.config cannot be read"


BEAMS = (
    '<b:beamlattice radius="4" minlength="0.001"><b:beams><b:beam v1="0" v2="1"/></b:beams></b:beamlattice>'
)


@row("3MF", "beam lattices")
def _():
    lattice = object_xml(1, BAR).replace("</mesh>", f"{BEAMS}</mesh>")
    text = model(
        lattice, attributes='xmlns:b="http://schemas.microsoft.com/3dmanufacturing/beamlattice/2017/02"'
    )
    yield "a.3mf", package(text), "its object 1 is a beam lattice, which is not read", "mesh of triangles"


@row("3MF", "Boolean shapes, displaced surfaces, level sets, slices")
def _():
    for element, said in (
        ("x:booleanshape", "a Boolean operation"),
        ("x:displacementmesh", "a displaced surface"),
        ("x:levelset", "a level set"),
    ):
        text = model(object_xml(1, BAR, more=f"<{element}/>"), attributes='xmlns:x="x"')
        yield "a.3mf", package(text), said, "mesh of triangles"
    text = object_xml(1, BAR).replace("<object", '<object meshresolution="lowres"')
    yield "a.3mf", package(model(text)), "a stack of slices", "mesh of triangles"


@row("3MF", "encrypted models (secure content)")
def _():
    yield (
        "a.3mf",
        package(model(object_xml(1, BAR)), Secure__keystore_dot_xml="<k/>"),
        "encrypted",
        "encryption",
    )


@row("3MF", "unknown extensions that the file requires")
def _():
    text = model(object_xml(1, BAR), attributes='xmlns:q="http://acme.example/bulge" requiredextensions="q"')
    yield "a.3mf", package(text), 20_000, "requires the 3MF extension http://acme.example/bulge"
    known = 'xmlns:m="http://schemas.microsoft.com/3dmanufacturing/material/2015/02" requiredextensions="m"'
    yield "a.3mf", package(model(object_xml(1, BAR), attributes=known)), lambda mesh: mesh.warnings == ()
