"""A package that ends the program when it is imported, to be left out."""

raise SystemExit("nothing to see here")
