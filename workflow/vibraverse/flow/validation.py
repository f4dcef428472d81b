"""The stages of the validation, a part of the table of all stages (``flow/steps.py``)."""

from __future__ import annotations

from vibraverse.contract.step import KNOWN_BODY, VALIDATION, Input, Output, Step

#: All stages of the validation, in the order of the chain.
VALIDATION_STEPS = (
    Step(
        name="validation_meshes",
        version=3,
        help="mesh a body whose frequencies are known, coarse to fine",
        per=KNOWN_BODY,
        family="geometry",
        inputs={},
        outputs={
            "meshes": Output(
                "validation_meshes",
                "validation/{body}/meshes.h5",
                "tetrahedra, coarse to fine, and metres per mesh unit (HDF5)",
            )
        },
        record="meshes",
        libraries=("gmsh", "h5py", "manifold3d", "mmgpy", "numba", "numpy", "scipy", "vtk"),
    ),
    Step(
        name="validation_modes",
        version=1,
        help="compare a body's frequencies with those it must have",
        per=KNOWN_BODY,
        family="fem",
        inputs={
            "meshes": Input(
                "validation_meshes", "tetrahedra, coarse to fine, and metres per mesh unit (HDF5)"
            )
        },
        outputs={
            "record": Output(
                "validation_comparison",
                "validation/{body}/comparison.json",
                "every frequency beside its reference (JSON)",
            )
        },
        record="record",
        libraries=("h5py", "numpy", "scipy", "scikit-fem", "pypardiso"),
    ),
    Step(
        name="validation_table",
        version=1,
        help="join the comparisons of all bodies, and plot them",
        per=VALIDATION,
        family="report",
        inputs={"comparisons": Input("validation_comparison", "comparisons of all bodies (JSON)", many=True)},
        outputs={
            "table": Output("validation_table", "validation/validation.tsv", "every comparison (TSV)"),
            "record": Output(
                "validation_record",
                "validation/validation.json",
                "the same with summaries, convergence and what is missed (JSON)",
            ),
            "plot": Output("validation_plot", "validation/convergence.svg", "errors against unknowns (SVG)"),
        },
        record="record",
        libraries=("matplotlib", "numpy"),
        passes_refusals=False,
    ),
)
