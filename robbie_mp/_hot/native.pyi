"""What the module written in C offers; its sources lie beside this file."""
