"""Queries on triangle surfaces: distance, closest point, containment, intersection, line of sight."""
