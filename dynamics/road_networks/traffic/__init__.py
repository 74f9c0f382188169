"""highway-env's traffic on road networks: lane choice, acceleration, right of way."""
