"""Many machines: a take's parts as tasks of an existing engine, Ray, and their results joined.

Chosen: an existing engine schedules, restarts and moves data. Rejected: a scheduler of our own. Farms that run a
command for each task need none of this: they run ``decogs-encode --only`` (docs/long-takes.md).
"""
