"""Stage ``validation_modes``: the frequencies of one body at every mesh and order, beside the known ones."""

from __future__ import annotations

from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Solve on every mesh and compare the frequencies."""
    import h5py

    from vibraverse.validation.bodies import BODIES
    from vibraverse.validation.study import study

    with h5py.File(job.inputs["meshes"]) as h5:
        meshes = [(h5[f"{number}/points"][()], h5[f"{number}/cells"][()]) for number in range(len(h5))]
        scale_m = float(h5.attrs["scale_m"])
    rows = study(BODIES[job.object], meshes, scale_m)
    job.write_record({"body": job.object, "rows": rows})
    print(
        f"{len(rows)} comparisons, {sum(row['verdict'] == 'missed' for row in rows)} outside their tolerance"
    )
