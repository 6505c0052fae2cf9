"""Many subjects at a glance: errors and outcomes over the population, and the page that shows them."""
