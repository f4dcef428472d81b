"""The stages that write the data of the page, a part of the table of all stages (``flow/steps.py``)."""

from __future__ import annotations

from vibraverse.contract.step import SHOWN_BODY, SHOWN_OBJECT, Input, Output, Step

#: A file for each object and body.
PAGE_STEPS = (
    Step(
        name="page_body",
        version=1,
        help="write the data with which a body is struck on the page",
        per=SHOWN_BODY,
        family="geometry",
        inputs={
            "basis": Input("basis", "the modal basis (HDF5)"),
            "modes": Input("modes", "the materials, and the size of the body (HDF5)"),
        },
        outputs={
            "script": Output(
                "page_body",
                "report/data/objects/{object}.{solidity}.js",
                "outside, frequencies and shapes at every Poisson's ratio (JavaScript)",
            ),
            "record": Output(
                "page_body_record",
                "report/data/objects/{object}.{solidity}.json",
                "how far strikes on the page are from those on the body (JSON)",
            ),
        },
        record="record",
        libraries=("h5py", "numpy", "pymeshlab", "scipy"),
        imports=("vibraverse.files.basis", "vibraverse.report.body", "h5py"),
    ),
    Step(
        name="page_object",
        version=1,
        help="write what the page shows of an object: facts, frequencies, pictures, refusals",
        per=SHOWN_OBJECT,
        family="report",
        inputs={
            "source_record": Input("source_record", "where it came from (JSON)"),
            "clean_record": Input("clean_record", "what was repaired (JSON)"),
            "views": Input("views", "folder of its pictures", record="images.json"),
            "hollow_record": Input("hollow_record", "the wall of the hollow body (JSON)", optional=True),
            "tets_record": Input("tets_record", "the tetrahedra of each body (JSON)", many=True),
            "modes": Input(
                "modes", "the modes of each body (HDF5); their folders name the bodies", many=True
            ),
            "sounds": Input("sounds", "folders of the sounds of each body", many=True, record="audio.json"),
            "basis": Input(
                "basis", "the surface of each body, where points are struck (HDF5)", many=True, optional=True
            ),
            "page_body_record": Input(
                "page_body_record", "the data of each body on the page (JSON)", many=True
            ),
        },
        outputs={
            "script": Output(
                "page_object",
                "report/data/objects/{object}.js",
                "facts, frequencies, struck points and refusals (JavaScript)",
            ),
            "turn": Output(
                "page_turn", "report/data/objects/{object}.webp", "up to six views side by side (WebP)"
            ),
            "thumbnail": Output(
                "page_thumbnail", "report/data/objects/{object}.thumb.webp", "a small picture (WebP)"
            ),
            "record": Output(
                "page_object_record",
                "report/data/objects/{object}.json",
                "its row of the page's index (JSON)",
            ),
        },
        record="record",
        libraries=("h5py", "numpy", "pillow"),
        imports=(
            "vibraverse.files.modes",
            "vibraverse.geometry.cleaning.cautions",
            "vibraverse.physics.cautions",
            "vibraverse.report.objects",
            "vibraverse.report.turn",
            "h5py",
        ),
        passes_refusals=False,
    ),
)
