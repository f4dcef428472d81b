"""What finished products show: their lineage, their repair, the progress and costs of a run."""
