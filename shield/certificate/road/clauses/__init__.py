"""The clauses of the certificate, one a file: the conditions that a plan has to satisfy."""
