"""The command line: demo | info | look | run | watch | compare | reproduce | benchmark."""

from napari_phase4d.cli.app import app, main

__all__ = ["app", "main"]
