"""Stage ``features``: one shard in, the arrays that training reads out."""

from __future__ import annotations

from vibraverse.contract.stage import Job


def run(job: Job) -> None:
    """Write a row of every array for each body, then what the rows are."""
    from vibraverse.contract.errors import UsageError
    from vibraverse.dataset.read.reader import Reader
    from vibraverse.learn.features import Unusable, write_features

    try:
        reader = Reader([job.inputs["shard"]])
    except ValueError as error:  # a file that is not a shard, or follows another schema
        raise UsageError(f"features: {error}") from None
    with reader:
        try:
            found = write_features(reader, job.outputs["features"], job.options)
        except Unusable as error:
            raise UsageError(f"features: {job.inputs['shard']}: {error}") from None
    job.write_record(found)
