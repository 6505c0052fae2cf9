"""A laboratory's raw files, or a project of the NMSM Pipeline, made into a subject folder."""
