"""Evidence for each effect and for published muscle laws, in gait and in other tasks."""
