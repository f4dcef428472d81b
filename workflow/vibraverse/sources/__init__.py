"""Sources of objects: parametric shape families, bundled models, mesh files, Objaverse."""
