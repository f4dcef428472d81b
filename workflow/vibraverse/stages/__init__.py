"""One module per stage: it reads files, calls the library and writes files. No mathematics here.

``run(job)`` does the stage's work; its contract is in ``vibraverse.flow.steps``. A warm process calls ``prepare()``, if
it exists, once before the stage's jobs.
"""
