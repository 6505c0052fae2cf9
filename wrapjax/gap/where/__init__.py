"""Where the error is: its parts, and the muscles that may make them."""
