"""Dense depth of keyframes: which are completed, their sparse points with errors, and the completion network's call.

Public: `completion_stage.complete_depth` and `load_completed`, `multiview_stage.refine_depth`,
`completed_submap.CompletedSubmap`, `sparse_depth.SparseDepthMaker`, `rectification.Rectifier`.
"""
