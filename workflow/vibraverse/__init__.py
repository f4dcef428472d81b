"""VibraVerse: meshes to shapes, modes, impact sounds and pictures that agree by physics."""

__version__ = "0.1.0"
