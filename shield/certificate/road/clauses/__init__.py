"""What a plan has to satisfy: the clauses of the certificate, one a file."""
