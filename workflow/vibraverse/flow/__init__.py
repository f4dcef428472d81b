"""The flow: which stage makes what from what, and for which objects."""
