//! Flags that override options of a project file.

use std::marker::PhantomData;

use clap::{ArgMatches, Args, Command, FromArgMatches};
use plenocal::{Error, Result};

/// Flags that were given on the command line for a struct of options. Flattened into the arguments of a command, it adds the
/// flags of the struct, all of them optional.
pub struct Given<T> {
    matches: ArgMatches,
    options: PhantomData<T>,
}

impl<T: Args> Given<T> {
    /// Overrides the options whose flags were given.
    pub fn apply(&self, options: &mut T) -> Result<()> {
        options.update_from_arg_matches(&self.matches).map_err(|e| Error::invalid(e.to_string()))
    }
}

impl<T: Args> Args for Given<T> {
    fn augment_args(command: Command) -> Command {
        T::augment_args_for_update(command)
    }

    fn augment_args_for_update(command: Command) -> Command {
        T::augment_args_for_update(command)
    }
}

impl<T: Args> FromArgMatches for Given<T> {
    fn from_arg_matches(matches: &ArgMatches) -> std::result::Result<Self, clap::Error> {
        Ok(Self { matches: matches.clone(), options: PhantomData })
    }

    fn update_from_arg_matches(
        &mut self,
        matches: &ArgMatches,
    ) -> std::result::Result<(), clap::Error> {
        self.matches = matches.clone();
        Ok(())
    }
}
