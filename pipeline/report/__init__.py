"""What people and other programs read of a run: trajectories, metrics, figures, `report.html`, exports.

Public: `report.write_report`, `mesh_export`, `rerun_export`, `server.view`; `page` writes `report.html`.
"""
