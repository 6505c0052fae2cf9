"""Which effect explains it: straight lines, what nobody can name, and the evidence against that."""
