"""Validation of the physics against measured or published frequencies, and those computed without finite elements."""
