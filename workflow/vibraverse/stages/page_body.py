"""Stage ``page_body``: the modal basis and the modes of a body in, the script with which the page strikes it out."""

from __future__ import annotations

from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Write the script and what it costs in accuracy."""
    import h5py

    from vibraverse.contract.products import read_provenance
    from vibraverse.contract.seeds import rng
    from vibraverse.files.basis import read_basis
    from vibraverse.physics.materials import PARAMETERS
    from vibraverse.report.body import body_data
    from vibraverse.report.packing import call

    with h5py.File(job.inputs["basis"]) as h5:
        basis = read_basis(h5)
    corrected = read_provenance(job.inputs["modes"])["options"]["corrected"]
    with h5py.File(job.inputs["modes"]) as h5:
        size_m, scale_m = float(h5.attrs["size_m"]), float(h5.attrs["scale_m"])
        groups = h5["materials"].values()
        modes = max(len(group["frequencies_hz"]) for group in groups)
        materials = {
            name: {
                **{key: float(group.attrs[key]) for key in PARAMETERS},
                "solved_directly": bool(group.attrs["solved_directly"]),
            }
            for name, group in h5["materials"].items()
        }
    data = body_data(basis, materials, modes, corrected, rng(job.object, job.solidity, "page"))
    about = {"size_m": size_m, "scale_m": scale_m, "materials": materials}
    script = call("vibraverse.body", job.object, job.solidity, {**about, **data})
    job.outputs["script"].write_text(script, encoding="ascii")
    measured, vertices = data["measured"], data["positions"]["shape"][1]
    job.write_record(
        {
            "object": job.object,
            "solidity": job.solidity,
            "order": basis.order,
            "bytes": len(script),
            "vertices": vertices,
            "columns": data["columns"]["shape"][0],
            "measured": measured,
        }
    )
    print(
        f"{len(script) / 1000:.0f} kB; struck at {measured['points']} points, sounds on the page differ by up to "
        f"{measured['rms_db']:.2g} dB rms in third-octave bands and {measured['level_db']:.2g} dB in level"
    )
