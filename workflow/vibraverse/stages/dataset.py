"""Stage ``dataset``: the products of a shard's objects in, one HDF5 shard out.

The stage finds the products by their paths below ``results``, so the command line stays short; the rule lists them as
inputs for Snakemake.
"""

from __future__ import annotations

from vibraverse.contract import products
from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Write the group of every object, then the attributes of the shard."""
    import h5py

    from vibraverse.contract.errors import UsageError
    from vibraverse.contract.texts import advised
    from vibraverse.dataset.write.pack import finish, pack_object
    from vibraverse.flow.paths import Paths

    paths = Paths(job.options.results)
    with h5py.File(job.outputs["shard"], "w") as h5:
        groups = h5.create_group("objects")
        try:
            packed = [
                pack_object(groups, paths, object_id, job.options, job.final["shard"].name)
                for object_id in job.options.objects
            ]
        except FileNotFoundError as error:
            again = advised("repair", "--delete", results=job.options.results)
            raise UsageError(
                f"dataset: {error.filename or error} does not exist; run {again}, which deletes what depends "
                "on it, then repeat the run"
            ) from None
        finish(h5, packed)
        products.write_provenance(h5, job.provenance())
