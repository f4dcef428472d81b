"""One module per stage: reads files, calls the library, writes files. No mathematics here.

``run(job)`` is the stage's work; what it promises stands in ``vibraverse.flow.steps``. Where there is a ``prepare()``,
a warm process calls it once before the stage's jobs.
"""
