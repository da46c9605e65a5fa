"""Pictures of a check, as SVG that stands in an HTML page: same input, same bytes."""
