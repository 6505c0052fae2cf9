"""Page that shows a model in motion in three dimensions, with curves beside it."""
