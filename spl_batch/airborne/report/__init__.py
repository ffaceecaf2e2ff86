"""Report of an airborne survey: model, sentences, pictures, page."""
