"""The replay of one episode: what was recorded, as data, and a page that shows it without a network."""
