"""The command `synth3dlanes`: each command parses, calls the library and prints."""
