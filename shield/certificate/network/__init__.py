"""The certificate on road networks: lanes that cross, join and part, and others who may take any way on them."""
