"""How the pictures of the documents are made, one module a kind of picture."""
