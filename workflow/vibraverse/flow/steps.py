"""The table of all stages: what each reads and writes, what it has one job for, its environment and its version.

The rules state the same for Snakemake and their readers; a test compares the two. Lineage, refusals, ``strike``,
``provenance``, ``repair``, ``status``, the command line, the warm process and the check of the images derive from this
table.
"""

from __future__ import annotations

from vibraverse.contract.step import (
    BODY,
    DATASET,
    OBJECT,
    SHARD,
    Input,
    Output,
    Step,
)
from vibraverse.flow.learning import LEARNING_STEPS
from vibraverse.flow.page import PAGE_STEPS
from vibraverse.flow.validation import VALIDATION_STEPS

#: Modules that the readers of mesh files import when they read.
_READERS = ("vibraverse.files.reading.rows", "vibraverse.files.reading.scene")
_SCIPY = ("scipy.interpolate", "scipy.ndimage", "scipy.optimize")
_VTK = ("vtkmodules.vtkFiltersCore", "vtkmodules.vtkInteractionWidgets", "vtkmodules.vtkViewsContext2D")

#: All stages, in the order of the chain.
STEPS = (
    Step(
        name="sources",
        version=2,
        help="fetch or generate one object's mesh, with where it came from",
        per=OBJECT,
        family="geometry",
        inputs={"file": Input("", "a mesh file of your own (origin files only)", optional=True)},
        outputs={
            "mesh": Output("source_mesh", "objects/{object}/source.mesh", "the mesh as it came"),
            "record": Output("source_record", "objects/{object}/source.json", "where it came from (JSON)"),
        },
        record="record",
        options="sources:SourceEntry",
        libraries=("manifold3d", "mmgpy", "numpy"),
        imports=("vibraverse.files.meshes", "manifold3d", "mmgpy"),
        packed="source",
    ),
    Step(
        name="clean",
        version=3,  # 3: parts that enclose nothing are left out, and the record says more
        help="make a closed, oriented, manifold surface in [-1, 1]³",
        per=OBJECT,
        family="geometry",
        inputs={
            "mesh": Input("source_mesh", "the mesh as it came"),
            "source_record": Input("source_record", "where it came from (JSON)"),
        },
        outputs={
            "surface": Output("surface", "objects/{object}/surface.ply", "cleaned surface (PLY)"),
            "record": Output(
                "clean_record", "objects/{object}/clean.json", "what was repaired, and the scale (JSON)"
            ),
        },
        record="record",
        options="geometry:Clean",
        libraries=("manifold3d", "numba", "numpy", "pymeshlab", "scipy", "vtk"),
        imports=("vibraverse.geometry.cleaning.clean", "pymeshlab", *_READERS, *_SCIPY),
        packed="clean",
    ),
    Step(
        name="grids",
        version=2,
        help="voxelise the surface and measure the signed distance",
        per=OBJECT,
        family="geometry",
        inputs={"surface": Input("surface", "cleaned surface (PLY)")},
        outputs={
            "grids": Output("grids", "objects/{object}/grids.h5", "occupancy and signed distance (HDF5)"),
            "coarse": Output("coarse", "objects/{object}/coarse.obj", "box mesh of the occupancy (OBJ)"),
        },
        record="grids",
        options="geometry:Grids",
        libraries=("h5py", "numba", "numpy", "open3d"),
        imports=("vibraverse.geometry.grids", "vibraverse.geometry.distance.field", "h5py", "open3d"),
    ),
    Step(
        name="hollow",
        version=8,
        help="take the inside out of the body",
        per=OBJECT,
        only="hollow",
        family="geometry",
        inputs={
            "surface": Input("surface", "cleaned surface (PLY)"),
            "grids": Input("grids", "its signed distance (HDF5)"),
        },
        outputs={
            "hollow_surface": Output(
                "hollow_surface", "objects/{object}/hollow/surface.ply", "outside and cavity surfaces (PLY)"
            ),
            "record": Output(
                "hollow_record", "objects/{object}/hollow/hollow.json", "thickness and cavities (JSON)"
            ),
        },
        record="record",
        options="geometry:Hollow",
        libraries=("h5py", "manifold3d", "mmgpy", "numba", "numpy", "scipy", "vtk"),
        imports=("vibraverse.geometry.hollow", *_VTK),
        packed="hollow/cavity",
    ),
    Step(
        name="tets",
        version=9,  # 9: limits of work and elements, thinning, a wrap; the record says what meshing cost
        help="fill a surface with tetrahedra",
        per=BODY,
        family="geometry",
        inputs={"surface": Input("boundary", "closed boundary surface of the body (PLY)")},
        outputs={
            "tets": Output("tets", "objects/{object}/{solidity}/tets.msh", "tetrahedra (gmsh .msh)"),
            "record": Output(
                "tets_record", "objects/{object}/{solidity}/tets.json", "counts, volume and quality (JSON)"
            ),
        },
        record="record",
        options="geometry:Tets",
        libraries=("gmsh", "meshio", "mmgpy", "numba", "pymeshlab", "pytetwild", "vtk"),
        imports=("vibraverse.geometry.meshing.tets", "vibraverse.files.tets", "gmsh", "meshio"),
        packed="{solidity}/tets/record",
    ),
    Step(
        name="basis",
        version=9,
        help="solve for the material-independent modal basis",
        per=BODY,
        family="fem",
        inputs={"tets": Input("tets", "tetrahedra (gmsh .msh)")},
        outputs={
            "basis": Output(
                "basis", "objects/{object}/{solidity}/basis.h5", "a basis for every Poisson's ratio (HDF5)"
            )
        },
        record="basis",
        options="physics:Basis",
        libraries=("numpy", "scipy", "scikit-fem", "pypardiso"),
        imports=(
            "vibraverse.physics.basis",
            "vibraverse.physics.breakdown",
            "vibraverse.files.basis",
            "pypardiso",
            "skfem",
        ),
    ),
    Step(
        name="modes",
        version=6,
        help="frequencies, damping and mode shapes of every material",
        per=BODY,
        family="fem",
        inputs={
            "basis": Input("basis", "the modal basis (HDF5)"),
            "tets": Input("tets", "tetrahedra (gmsh .msh), for materials that the basis does not serve"),
            "clean_record": Input("clean_record", "clean.json, for the object's size"),
        },
        outputs={
            "modes": Output(
                "modes",
                "objects/{object}/{solidity}/modes.h5",
                "frequencies, damping and mode shapes of every material (HDF5)",
            )
        },
        record="modes",
        options="physics:MaterialModes",
        libraries=("numpy", "scipy"),
        imports=("vibraverse.physics.modes", "vibraverse.physics.shapes"),
    ),
    Step(
        name="audio",
        version=4,
        help="render the impact sounds",
        per=BODY,
        family="fem",
        inputs={
            "basis": Input("basis", "the surface that is struck, where points are (HDF5)", optional=True),
            "modes": Input("modes", "frequencies and damping of every material (HDF5)"),
        },
        outputs={
            "sounds": Output(
                "sounds",
                "objects/{object}/{solidity}/sounds",
                "folder for MATERIAL.wav, MATERIAL-pK.wav (struck point K) and audio.json: gains, durations, counts",
                record="audio.json",
            )
        },
        record="sounds",
        options="media:Audio",
        libraries=("numpy", "scipy", "h5py", "soundfile"),
        imports=(
            "vibraverse.files.modes",
            "vibraverse.media.audio",
            "vibraverse.physics.impulse",
            "soundfile",
        ),
        packed="{solidity}/audio",
    ),
    Step(
        name="images",
        version=2,
        help="render views of the outside",
        per=OBJECT,
        family="render",
        inputs={"surface": Input("surface", "cleaned surface (PLY)")},
        outputs={
            "views": Output(
                "views",
                "objects/{object}/views",
                "folder for LOOK-VIEW.png, for instance clay-00.png, and images.json: directions, looks and camera",
                record="images.json",
            )
        },
        record="views",
        options="media:Images",
        libraries=("numpy", "pyvista", "vtk", "pillow", "meshio"),
        imports=("vibraverse.media.images", "pyvista.plotting"),
    ),
    *PAGE_STEPS,
    Step(
        name="dataset",
        version=7,
        help="pack objects into one HDF5 shard",
        per=SHARD,
        family="dataset",
        inputs={},
        outputs={"shard": Output("shard", "dataset/shards/{shard}.h5", "the shard (HDF5)")},
        record="shard",
        options="dataset:ShardOptions",
        libraries=("numpy", "h5py", "meshio", "soundfile"),
        passes_refusals=False,
    ),
    Step(
        name="index",
        version=7,
        help="write the dataset's index, refusals and record",
        per=DATASET,
        family="dataset",
        inputs={
            "shards": Input("shard", "all shards (HDF5)", many=True),
            "kept": Input("", "splits.tsv of an earlier dataset, to keep its splits", optional=True),
            "resolved": Input(
                "config", "configuration of the run, with every default filled in", optional=True
            ),
        },
        outputs={
            "index": Output(
                "index", "dataset/index.tsv", "index.tsv: one row per object, solidity and material"
            ),
            "columns": Output(
                "index_columns", "dataset/index.h5", "index.h5: the same rows by column, as readers open them"
            ),
            "parquet": Output("index_parquet", "dataset/index.parquet", "index.parquet: the same rows"),
            "splits": Output(
                "splits",
                "dataset/splits.tsv",
                "splits.tsv: one row per object, with the object whose copy it is",
            ),
            "refusals": Output(
                "refusals", "dataset/refusals.tsv", "refusals.tsv: one row per refused object or body"
            ),
            "card": Output(
                "card",
                "dataset/README.md",
                "README.md: counts, sources, licences, ranges, limits, how to cite and to rebuild",
            ),
            "overview": Output("overview", "dataset/overview.png", "overview.png: some of the objects"),
            "croissant": Output(
                "croissant", "dataset/croissant.json", "croissant.json: the metadata dataset searches read"
            ),
            "record": Output(
                "dataset_record",
                "dataset/dataset.json",
                "dataset.json: counts, materials, ranges, versions, checksums",
            ),
            "config": Output(
                "dataset_config",
                "dataset/config.yaml",
                "config.yaml: that configuration, beside the dataset",
                optional=True,
            ),
            "sums": Output(
                "dataset_sums", "dataset/SHA256SUMS", "SHA256SUMS: checksums of all files, for `sha256sum -c`"
            ),
        },
        record="record",
        options="dataset:IndexOptions",
        libraries=("numpy", "h5py", "pillow", "pyarrow", "scipy"),
        passes_refusals=False,
    ),
    Step(
        name="report",
        version=9,  # 7: one page for any number of objects; 8: its scripts are made small; 9: light, round times
        help="write the page people open",
        per=DATASET,
        family="report",
        inputs={
            "index": Input("index_columns", "index.h5"),
            "record": Input("dataset_record", "dataset.json"),
            "validation": Input(
                "validation_record", "validation.json, where the validation was run", optional=True
            ),
            "learning": Input("learn_page", "the page of learning, to link, where it exists", optional=True),
        },
        outputs={
            "page": Output(
                "report",
                "report/index.html",
                "index.html; scripts, styles, index and thumbnails go to page/ beside it",
            ),
            "times": Output(
                "page_times", "report/data/times.js", "computing times, from the journal (JavaScript)"
            ),
        },
        options="dataset:ReportOptions",
        libraries=("jinja2", "numpy", "h5py", "pillow"),
        passes_refusals=False,
    ),
    *VALIDATION_STEPS,
    *LEARNING_STEPS,
)

#: Stages by name.
BY_NAME = {step.name: step for step in STEPS}

#: Stages of objects and bodies, in the order of the chain.
CHAIN = tuple(step for step in STEPS if step.per in (OBJECT, BODY))

#: Version of each stage; every rule carries the version of its stage as a parameter.
VERSIONS = {step.name: step.version for step in STEPS}
