"""Where objects come from: parametric shape families, bundled models, mesh folders, Objaverse."""
