"""Certified worst cases: the search, its bounds, and the runs that answer it.

==================== ====================================================================================
a run                ``check`` (simulation), ``gap``, ``real_machine`` (both), ``measure``, with their ``options``
what it returns      ``check_result``, ``gap_result``, ``compose``, ``choose``, ``failure_probability``
the search           ``search``: ``settings``, ``state``, ``acquisition``, ``stopping``, ``assembly``
the bound            ``confidence`` (formulas), ``confidence_set``, ``modes``, ``posterior``, ``kernels``
the box              ``bounds``, ``tiling``, ``coverage``
rollouts             ``experiments``, ``recorded``, ``pairing``, ``voids``, ``observers``
before any rollout   ``plan``, ``pilot``, ``feasibility``, ``sample_complexity``
==================== ====================================================================================
"""
