"""Methods beside one another: what is compared, the tests, and the folder they are written to."""
