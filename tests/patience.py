"""How long a test waits for what another task, thread or process is to bring about."""

PATIENCE_S = 60.0
"""Only what never comes takes so long: machines that stand still for seconds fail nothing."""
