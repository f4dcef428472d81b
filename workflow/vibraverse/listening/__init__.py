"""What a recorded impact sound says about the body that was struck: its material, its size, its wall.

Arrays in, arrays out. :mod:`strikes` finds the hit in a recording, :mod:`peaks` its modal frequencies and decay rates,
:mod:`assignment` which modes of the body these are, and :mod:`fit` the material that agrees with them.
"""
