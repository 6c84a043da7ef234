"""Loop closing, after the depth: detection of revisits, a Sim(3) pose graph, and adjustment to the images.

Public: `close_loops.close_loops_stage` and `load_loops_closed`. In order: `detection`, `keyframe_pose_graph`,
`loop_adjustment`.
"""
