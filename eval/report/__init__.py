"""Pictures of a run: maps as images and for map_server, and figures like the paper's."""
