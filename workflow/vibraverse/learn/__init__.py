"""Learning: the trainer, and the tasks that it trains.

A :class:`~vibraverse.learn.task.Task` brings a network, samples, a loss and its metrics;
:func:`~vibraverse.learn.train.train` does the rest and knows nothing of the task. Stages hand in arrays and options;
nothing here knows the workflow. Everything that must survive a kill lies in one work folder.
"""
