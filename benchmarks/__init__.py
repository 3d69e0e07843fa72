"""Benchmarks: speed, memory and accuracy, each figure measured in the run that prints it.

``python -m benchmarks.shift``, ``benchmarks.vibration``, ``benchmarks.accuracy``, each with ``--json``; and
``python -m pytest benchmarks`` for the parts one by one. What is measured, and how: docs/benchmarks.md.
"""
