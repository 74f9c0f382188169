"""Reports: tables, figures, pages and films."""
