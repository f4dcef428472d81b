"""From a closed surface to good triangles and tetrahedra."""
