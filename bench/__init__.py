"""The bench: variants of the encoder run over rigs, measured on a held-out camera, and written up as a report.

``metrics``, ``regions``, ``measuring``: what a stream looks like against a camera that training never saw.
``ablations``: parts of a method left out, as selection rule and frame methods.
``variants``, ``runs``: what is run, and what came of it. ``paper``, ``choices``, ``rates``: which questions are asked
of a rig. ``rivals``, ``rival_runs``: other ways to keep a stream's frames, and what came of them.
``report``, ``tables``, ``plots``: the answers as Markdown, pictures and JSON.
"""
