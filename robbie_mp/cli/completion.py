"""`robbie completion SHELL`: print a script that makes a shell complete `robbie`'s commands."""

import argparse

from robbie_mp.cli.parser import Commands, add_command

PROGRAMS = ["robbie"]


def add_parser(subparsers: Commands) -> None:
    """Add `completion` to the commands."""
    parser = add_command(
        subparsers,
        "completion",
        "print a completion script for your shell",
        "Print a script that lets your shell complete commands, options, and the names of modules, message "
        "types, topics, settings and profiles.",
        [
            "robbie completion bash >> ~/.bashrc",
            "robbie completion zsh >> ~/.zshrc",
            "robbie completion fish > ~/.config/fish/completions/robbie.fish",
        ],
    )
    parser.add_argument("shell", choices=["bash", "zsh", "fish"], help="your shell")
    parser.set_defaults(command=completion)


def completion(arguments: argparse.Namespace) -> int:
    """Print the script."""
    from argcomplete.shell_integration import shellcode  # noqa: PLC0415

    print(shellcode(PROGRAMS, shell=arguments.shell))
    return 0
