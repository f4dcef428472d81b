"""Meshing: from a closed surface to good triangles and tetrahedra."""
