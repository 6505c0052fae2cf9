"""What a person sees of a result: folders of plain files, figures and a page."""
