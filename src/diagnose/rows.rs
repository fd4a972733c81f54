//! The rows of the table of evidence, and the fits behind them.

use super::candidates::Candidates;
use super::evidence::EvidenceTable;
use super::fit::Fit;
use super::laws::Laws;
use super::left_out::Contender;
use super::measured::MeasuredFit;
use super::nuisance::Nuisance;
use super::verdict::{Effect, Role};
use crate::sand::Term;

/// Where the fit of a row is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// The stated sand, with the stated priors of all effects of measuring.
    Plain,
    /// The stated sand, with the present priors.
    Stated,
    Base,
    Candidate(usize),
    Measured(usize),
    Absent(usize),
}

/// A row of the table: a fit, and laws of which it may have one.
#[derive(Clone, Copy, Debug)]
pub struct ModelRow {
    pub role: Role,
    pub place: Place,
    pub laws: Option<usize>,
}

/// All fits of one selection.
pub struct Fits {
    pub candidates: Candidates,
    /// The plain model; its nuisances have their stated priors.
    pub plain: MeasuredFit,
    /// Laws alone, and laws beside the leading cause.
    pub laws: [Laws; 2],
    pub rows: Vec<ModelRow>,
}

impl Fits {
    pub fn fit(&self, row: usize) -> &Fit {
        let c = &self.candidates;
        match self.rows[row].place {
            Place::Plain => &self.plain.fit,
            Place::Stated => &c.stated,
            Place::Base => &c.base,
            Place::Candidate(k) => &c.fits[k],
            Place::Measured(k) => &c.measured[k].fit,
            Place::Absent(k) => &c.absent[k].fit,
        }
    }

    pub fn nuisances(&self, row: usize) -> &[Nuisance] {
        match self.rows[row].place {
            Place::Plain => &self.plain.nuisances,
            Place::Stated | Place::Base => &self.candidates.base_nuisances,
            Place::Measured(k) => &self.candidates.measured[k].nuisances,
            Place::Absent(k) => &self.candidates.absent[k].nuisances,
            _ => &self.candidates.around.nuisances,
        }
    }

    pub fn contender(&self, row: usize) -> Contender<'_> {
        let columns = self.rows[row].laws.map_or(&[][..], |l| &self.laws[l].columns);
        Contender { fit: self.fit(row), nuisances: self.nuisances(row), columns }
    }

    pub fn contenders(&self) -> Vec<Contender<'_>> {
        (0..self.rows.len()).map(|k| self.contender(k)).collect()
    }

    /// Are the coefficients of a row the stated ones?
    pub fn is_stated(&self, row: usize) -> bool {
        matches!(self.rows[row].role, Role::Plain | Role::Established)
    }

    /// What a row names, with what is established.
    pub fn effects(&self, row: usize) -> Vec<Effect> {
        if self.rows[row].role == Role::Plain {
            return Vec::new();
        }
        // The base without an effect has the effects of the row that it is compared with.
        let with = match self.rows[row].place {
            Place::Absent(k) => &self.candidates.measured[k].nuisances,
            _ => self.nuisances(row),
        };
        let wide = with.iter().enumerate().filter(|(_, n)| n.sd > n.stated_sd);
        let measuring = wide.map(|(k, _)| Effect::Measuring(k));
        measuring.chain(self.fit(row).ids.iter().map(|id| Effect::Mechanism(*id))).collect()
    }

    /// The law that a row chose with no condition left out, with the coefficient of the linear fit.
    pub fn law(&self, table: &EvidenceTable, row: usize) -> Option<Term> {
        let own = &table.rows[row].predicted;
        let term = &self.laws[self.rows[row].laws?].terms[own.law?];
        Some(Term { coefficient: *own.step.as_slice().last()?, ..term.clone() })
    }

    /// The rows: the plain model, the established one, the base, all candidates, and the laws.
    pub fn with_rows(mut self) -> Self {
        let row = |role, place| ModelRow { role, place, laws: None };
        let mut rows = vec![row(Role::Plain, Place::Plain)];
        if self.candidates.around.nuisances.iter().any(|n| n.sd > n.stated_sd) {
            rows.push(row(Role::Established, Place::Stated));
        }
        rows.push(row(Role::Base, Place::Base));
        // A fit in which a cause has its value of the plain sand is left out, because this cause explains nothing.
        let fits = self.candidates.fits.iter().enumerate().filter(|(_, fit)| !fit.is_idle());
        rows.extend(fits.map(|(k, _)| row(Role::Causes, Place::Candidate(k))));
        rows.extend((0..self.candidates.measured.len()).map(|k| row(Role::Causes, Place::Measured(k))));
        if !self.laws[0].columns.is_empty() {
            rows.push(ModelRow { laws: Some(0), ..row(Role::Law, Place::Base) });
        }
        if let Some(k) = self.candidates.leading.filter(|_| !self.laws[1].columns.is_empty()) {
            rows.push(ModelRow { laws: Some(1), ..row(Role::Beside, Place::Candidate(k)) });
        }
        rows.extend((0..self.candidates.absent.len()).map(|k| row(Role::Absent, Place::Absent(k))));
        self.rows = rows;
        self
    }
}
