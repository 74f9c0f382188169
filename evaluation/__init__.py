"""Everything that measures: settings, training, episodes, statistics and the command line."""
