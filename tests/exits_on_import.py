"""A package that ends the program when it is imported, to be left out."""

message = "nothing to see here"
raise SystemExit(message)
