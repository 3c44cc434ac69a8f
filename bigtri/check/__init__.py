"""Every stage by itself, and where two backends differ."""
