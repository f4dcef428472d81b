"""Extensions of glTF 2.0: those that change geometry and are read, those that change none, and the rest.

An exporter lists an extension under ``extensionsRequired`` only if the file is useless without it. Blender lists
instances under ``extensionsUsed`` alone, so every extension is looked for where it stands.
"""

from __future__ import annotations

from vibraverse.files.reading.document import Fields
from vibraverse.files.reading.mistakes import Unsupported

INSTANCES = "EXT_mesh_gpu_instancing"
LEVELS = "MSFT_lod"
RESTART = "KHR_mesh_primitive_restart"
VISIBILITY = "KHR_node_visibility"
#: Extensions that change geometry and are read.
READ = (INSTANCES, LEVELS, RESTART, VISIBILITY, "KHR_mesh_quantization")

DRACO = "KHR_draco_mesh_compression"
#: Extensions that compress buffers. A file may hold the plain buffer beside the compressed one.
_PACKED_BUFFERS = ("EXT_meshopt_compression", "KHR_meshopt_compression")
#: Extensions that are refused where a file is useless without them.
REFUSED = (DRACO, *_PACKED_BUFFERS)

#: Beginnings of the names of extensions that change no geometry at rest.
SHAPELESS = (
    "ADOBE_materials_", "AGI_", "CESIUM_", "EXT_lights_", "EXT_mesh_features", "EXT_mesh_manifold",
    "EXT_structural_metadata", "EXT_texture_", "FB_geometry_metadata", "GODOT_", "GRIFFEL_", "KHR_animation_",
    "KHR_audio", "KHR_interactivity", "KHR_lights_", "KHR_materials_", "KHR_node_hoverability",
    "KHR_node_selectability", "KHR_physics_", "KHR_techniques_", "KHR_texture_", "KHR_xmp", "MPEG_audio",
    "MPEG_texture_video", "MSFT_packing_", "MSFT_texture_", "NV_materials_", "OMI_", "VRM",
)  # fmt: skip

_UNCOMPRESSED = "Export it again without mesh compression (in Blender's export, switch off Compression)."


def check(document: Fields) -> list[str]:
    """Return the warnings about a document's extensions.

    Raises :class:`Unsupported` if its meshes cannot be read because of one.
    """
    required = document.texts("extensionsRequired")
    for name in required:
        if name in REFUSED:
            raise compressed(name)
    for buffer in document.items("buffers"):
        for name in _PACKED_BUFFERS:
            if "uri" not in buffer and (found := extension(buffer, name)) and found.true("fallback"):
                raise compressed(name)
    return [
        f"the file requires the glTF extension {name:.60}, which is not read and may change the shape."
        for name in required
        if name not in READ and not name.startswith(SHAPELESS)
    ]


def extension(place: Fields, name: str) -> Fields | None:
    """Return an extension's object of a part of the document, or None."""
    if "extensions" not in place or name not in place.fields("extensions"):
        return None
    return place.fields("extensions").fields(name)


def compressed(name: str) -> Unsupported:
    """Return the error for a compressed mesh."""
    return Unsupported(f"it is compressed with {name}, which is not supported", _UNCOMPRESSED)
