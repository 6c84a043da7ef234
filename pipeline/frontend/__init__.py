"""Front ends: working frames to submaps of poses and sparse points.

`base.FrontEnd` is the protocol, `registry.FRONT_ENDS` the table, `structure_stage.solve_structure` the stage: it runs
one front end, or the better of two by `scoring`. A new front end is one file and one row (docs/extending.md).
"""
