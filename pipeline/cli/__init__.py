"""The commands `reconstruct` and `haustra`: options to calls, errors to one sentence and an exit code.

Entry points: `main.main`; `run_commands` (reconstruct, view, batch), `phantom`, `batch.run_batch`.
"""
