"""Certificate on road networks: lanes cross, merge and diverge, and the other vehicles may take any way on them."""
