"""Looks at finished products: their lineage, their repair, a run's progress and costs."""
