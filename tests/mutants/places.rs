//! Where a source file can be changed in one place, and how.

use std::ops::Range;

use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::{BinOp, Expr, UnOp};

/// A span of bytes and what to put there instead.
pub struct Place {
    pub range: Range<usize>,
    pub instead: String,
}

/// All places of a file's code outside its tests, constants, patterns, types and macros.
pub fn of(text: &str) -> Vec<Place> {
    let file = syn::parse_file(text).expect("source that compiles");
    let mut finder = Finder {
        text,
        places: Vec::new(),
    };
    finder.visit_file(&file);
    finder.places
}

struct Finder<'a> {
    text: &'a str,
    places: Vec<Place>,
}

impl Finder<'_> {
    fn text(&self, part: &impl Spanned) -> &str {
        &self.text[part.span().byte_range()]
    }

    /// `whole` with `part` replaced by `instead`.
    fn swap(&mut self, whole: &Expr, part: &impl Spanned, instead: &str) {
        let (whole, part) = (whole.span().byte_range(), part.span().byte_range());
        let (before, after) = (whole.start..part.start, part.end..whole.end);
        let instead = format!("{}{instead}{}", &self.text[before], &self.text[after]);
        self.places.push(Place {
            range: whole,
            instead,
        });
    }
}

/// Whether this is compiled for tests only, or not at all with the default features.
fn left_out(attributes: &[syn::Attribute]) -> bool {
    attributes.iter().any(|attribute| match &attribute.meta {
        syn::Meta::List(list) if list.path.is_ident("cfg") => {
            let when = list.tokens.to_string().replace(' ', "");
            when.contains("test") || when.contains("not(")
        }
        meta => meta.path().is_ident("test"),
    })
}

fn opposite(operator: &BinOp) -> Option<&'static str> {
    Some(match operator {
        BinOp::Lt(_) => "<=",
        BinOp::Le(_) => "<",
        BinOp::Gt(_) => ">=",
        BinOp::Ge(_) => ">",
        BinOp::Eq(_) => "!=",
        BinOp::Ne(_) => "==",
        BinOp::And(_) => "||",
        BinOp::Or(_) => "&&",
        BinOp::Add(_) => "-",
        BinOp::Sub(_) => "+",
        BinOp::Mul(_) => "/",
        BinOp::Div(_) => "*",
        BinOp::AddAssign(_) => "-=",
        BinOp::SubAssign(_) => "+=",
        BinOp::MulAssign(_) => "/=",
        BinOp::DivAssign(_) => "*=",
        _ => return None,
    })
}

fn binds(condition: &Expr) -> bool {
    match condition {
        Expr::Let(_) => true,
        Expr::Binary(both) => binds(&both.left) || binds(&both.right),
        _ => false,
    }
}

fn leaves(block: &syn::Block) -> bool {
    let [syn::Stmt::Expr(only, _)] = block.stmts.as_slice() else {
        return false;
    };
    matches!(only, Expr::Return(_) | Expr::Continue(_) | Expr::Break(_))
}

impl<'ast> Visit<'ast> for Finder<'_> {
    fn visit_expr(&mut self, expr: &'ast Expr) {
        match expr {
            Expr::Binary(both) if !binds(expr) => {
                if let Some(other) = opposite(&both.op) {
                    self.swap(expr, &both.op, other);
                }
            }
            Expr::Unary(unary) if !matches!(unary.op, UnOp::Deref(_)) => {
                self.swap(expr, &unary.op, "");
            }
            Expr::MethodCall(call) if call.method == "min" => self.swap(expr, &call.method, "max"),
            Expr::MethodCall(call) if call.method == "max" => self.swap(expr, &call.method, "min"),
            Expr::Lit(lit) if matches!(&lit.lit, syn::Lit::Float(f) if f.base10_parse::<f64>().is_ok_and(|value| value != 0.0)) =>
            {
                let instead = format!("({} * 1.5)", self.text(expr));
                self.swap(expr, expr, &instead);
            }
            Expr::Index(index) => {
                if let Expr::Binary(both) = &*index.index
                    && matches!(both.op, BinOp::Add(_))
                    && self.text(&both.right) == "1"
                {
                    let instead = self.text(&both.left).to_owned();
                    self.swap(&index.index, &index.index, &instead);
                }
            }
            Expr::If(branch) if leaves(&branch.then_branch) && !binds(&branch.cond) => {
                let instead = format!("!({})", self.text(&branch.cond));
                self.swap(&branch.cond, &branch.cond, &instead);
            }
            // Computed by the compiler.
            Expr::Const(_) => return,
            Expr::Repeat(repeat) => return self.visit_expr(&repeat.expr),
            _ => {}
        }
        visit::visit_expr(self, expr);
    }

    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        if !left_out(&item.attrs) {
            visit::visit_item_mod(self, item);
        }
    }

    fn visit_item_fn(&mut self, item: &'ast syn::ItemFn) {
        if !left_out(&item.attrs) && item.sig.constness.is_none() {
            visit::visit_item_fn(self, item);
        }
    }

    fn visit_impl_item_fn(&mut self, item: &'ast syn::ImplItemFn) {
        if !left_out(&item.attrs) && item.sig.constness.is_none() {
            visit::visit_impl_item_fn(self, item);
        }
    }

    fn visit_item_impl(&mut self, item: &'ast syn::ItemImpl) {
        let name = item.trait_.as_ref().and_then(|of| of.1.segments.last());
        let words = name.is_some_and(|name| name.ident == "Display" || name.ident == "Debug");
        if !left_out(&item.attrs) && !words {
            visit::visit_item_impl(self, item);
        }
    }

    fn visit_item_const(&mut self, _: &'ast syn::ItemConst) {}
    fn visit_item_static(&mut self, _: &'ast syn::ItemStatic) {}
    fn visit_impl_item_const(&mut self, _: &'ast syn::ImplItemConst) {}
    fn visit_trait_item_const(&mut self, _: &'ast syn::TraitItemConst) {}
    fn visit_variant(&mut self, _: &'ast syn::Variant) {}
    fn visit_type(&mut self, _: &'ast syn::Type) {}
    fn visit_pat(&mut self, _: &'ast syn::Pat) {}
    fn visit_attribute(&mut self, _: &'ast syn::Attribute) {}
    fn visit_macro(&mut self, _: &'ast syn::Macro) {}
    fn visit_generic_argument(&mut self, _: &'ast syn::GenericArgument) {}
}
