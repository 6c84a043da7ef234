"""The run folder: names of artefacts, finished stages, the lock, and the processes that work in it.

Start with `workspace.Workspace`, which every stage receives, and `stage.load_or_make`. `subprocesses` runs modules in
processes of their own, `ray_cluster` on a cluster; `inputs` names what a run depends on outside its folder.
"""
