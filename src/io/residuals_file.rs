//! Residuals as CSV, one line for each observation used.

use std::io::{self, Write};

use crate::model::Reprojection;

/// Writes `kind,frame,cluster,k,l,lens_type,u,v,rho,du,dv,drho`: what was observed and observed
/// minus projected, px. `kind` is `feature` or `center`; lens types count from 1; what does not
/// apply is left empty.
pub fn write_residuals(out: &mut dyn Write, reprojection: &Reprojection) -> io::Result<()> {
    writeln!(out, "kind,frame,cluster,k,l,lens_type,u,v,rho,du,dv,drho")?;
    for r in &reprojection.features {
        let f = &r.feature;
        let (rho, drho) = match r.drho_px {
            Some(drho) => (f.rho_px.to_string(), drho.to_string()),
            None => (String::new(), String::new()),
        };
        writeln!(
            out,
            "feature,{},{},{},{},{},{},{},{rho},{},{},{drho}",
            f.frame,
            f.corner,
            f.k,
            f.l,
            r.lens_type + 1,
            f.u_px,
            f.v_px,
            r.du_px,
            r.dv_px
        )?;
    }
    for r in &reprojection.centers {
        let c = &r.center;
        writeln!(
            out,
            "center,,,{},{},{},{},{},,{},{},",
            c.k,
            c.l,
            r.lens_type + 1,
            c.u_px,
            c.v_px,
            r.du_px,
            r.dv_px
        )?;
    }
    Ok(())
}
