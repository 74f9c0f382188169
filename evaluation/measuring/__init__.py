"""From episodes to figures: metrics, intervals, attribution."""
