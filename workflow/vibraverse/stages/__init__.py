"""One module per stage: reads files, calls the library, writes files. No mathematics here."""

#: Stage versions, in the order of the chain. Raise one when the stage's products change for the same
#: inputs: every rule carries its stage's version as a parameter, so Snakemake reruns what depends on it.
VERSIONS = {
    "sources": 2,
    "clean": 2,
    "grids": 2,
    "hollow": 8,
    "tets": 7,
    "basis": 9,
    "modes": 6,
    "audio": 3,
    "images": 2,
    "dataset": 7,
    "index": 6,
    "report": 4,
    "validation_meshes": 3,
    "validation_modes": 1,
    "validation_table": 1,
}
