"""The traffic of any of highway-env's road networks, compiled, the same to the last bit."""
