"""Planners: each takes hitches and requirements, and returns trajectories or says what binds.

``separate``, ``straight_flight``, ``fly_action`` and ``blended_flight`` are functions. Where there
is something to look at before it is solved, a frozen record holds what is asked: the
``SeparationTask``, the ``PreHitch``, the ``Approach``, and the optimiser with its ``problem``.
"""
